"""Adam in plain PyTorch."""

from torch import Tensor

from nerf.types import STEEPEST

BETA_MEAN, BETA_SQUARE, EPSILON = 0.9, 0.99, 1e-15


def adam(weights: Tensor, mean: Tensor, square: Tensor, rate: float, step: int) -> None:
    """Do the step-th (from 1) step of Adam with the gradient in `.grad`, in place (Kingma and Ba 2015, algorithm 1).

    The gradient is held within STEEPEST.
    """
    assert weights.grad is not None
    gradient = weights.grad.clamp(-STEEPEST, STEEPEST)
    mean.lerp_(gradient, 1 - BETA_MEAN)
    square.mul_(BETA_SQUARE).addcmul_(gradient, gradient, value=1 - BETA_SQUARE)
    scale = (square / (1 - BETA_SQUARE**step)).sqrt_().add_(EPSILON)
    weights.addcdiv_(mean, scale, value=-rate / (1 - BETA_MEAN**step))
