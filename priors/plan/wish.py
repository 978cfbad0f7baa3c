"""What a fit needs: its views and its aim. They decide which prior is worth its time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from priors.bench.budget import Budget, told
from priors.bench.candidates import Candidate, most_accurate

Aim = Literal["pictures", "geometry"]
STUDY_DENSE = (
    "the study (Wang et al., 2023): in dense views a prior changes PSNR by less than 1 dB; ours (docs/nerf.md, the "
    "street): with a prior 4 s of training reach what colours alone reach in 36 s, so take one where time is short"
)
STUDY_SPARSE = (
    "the study (Wang et al., 2023): in sparse views every prior raises PSNR, by 1.1 to 3.2 dB, and mono comes within "
    "0.4 dB of true depth; ours (docs/nerf.md, drive 0001): 22.09 dB alone, 23.33 dB with stereo"
)
STUDY_GEOMETRY = (
    "a field's depth follows its prior: AbsRel 0.54 alone and 0.04 with stereo (docs/nerf.md, drive 0001); the study: "
    "in dense views too a prior takes at least 30 % of AbsRel"
)


@dataclass(frozen=True)
class PriorChoice:
    """Which prior a field should have."""

    candidate: Candidate | None
    """None: it needs none, or none can be made."""
    reason: str
    """Why, in a sentence."""
    evidence: str
    """What was measured: the study's finding, and our own figures."""

    @property
    def name(self) -> str:
        """What tables call it; none where there is none."""
        return "none" if self.candidate is None else self.candidate.name


def choose_prior(among: Sequence[Candidate], dense_views: bool, aim: Aim, budget: Budget | None = None) -> PriorChoice:
    """Choose a prior for a field.

    Dense views of which pictures alone are wanted need none. Sparse views take the cheapest dense prior, or what a
    budget allows. Where geometry is wanted it is the most accurate.

    Args:
        among: what can be built, the fastest first.
        dense_views: whether all views train.
        aim: what is wanted.
        budget: what a frame may take; None: whatever it takes.

    Raises:
        DataError: nothing keeps to the budget.
    """
    dense = [each for each in among if each.dense]
    if dense_views and aim == "pictures":
        return PriorChoice(None, "dense views need no prior for pictures", STUDY_DENSE)
    evidence = STUDY_GEOMETRY if aim == "geometry" else STUDY_SPARSE
    if not dense:
        return PriorChoice(None, "nothing here makes dense maps", evidence)
    if budget is not None:
        chosen = budget.choose(dense)
        return PriorChoice(chosen, f"the best for {budget}", evidence)
    if aim == "geometry":
        best = most_accurate(dense)
        if best is not None:
            return PriorChoice(
                best, f"geometry is wanted: it is the most accurate, AbsRel {best.abs_rel:.4f}", evidence
            )
    cheapest = min(dense, key=lambda each: each.seconds)
    return PriorChoice(cheapest, f"it is the cheapest that is dense, {told(cheapest.seconds)} a frame", evidence)
