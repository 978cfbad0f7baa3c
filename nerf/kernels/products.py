"""The products of tiles that this CPU does fastest: `tiles` with matrix tiles, `dots` without."""

from priors.cpu import mode

if mode() in ("amx", "amx_emulated"):
    from nerf.kernels.tiles import OPERAND, TILE, begin, end, product, product_added, store_operand
else:
    from nerf.kernels.dots import OPERAND, TILE, begin, end, product, product_added, store_operand

__all__ = ["OPERAND", "TILE", "begin", "end", "product", "product_added", "store_operand"]
