"""The products of tiles that this CPU does fastest: `tiles` with matrix tiles, `dots` without."""

from nerf.kernels.cpu import lanes
from nerf.kernels.cpu.lanes import TILE
from priors.machine.cpu import mode

if mode() in ("amx", "amx_emulated"):
    from nerf.kernels.cpu.tiles import OPERAND, begin, end, product, product_added, store_operand
else:
    from nerf.kernels.cpu.dots import OPERAND, begin, end, product, product_added, store_operand

pack = lanes.pack
if mode() in ("amx", "avx512_bf16"):
    from nerf.kernels.cpu.x86 import pack_fast as pack

__all__ = ["OPERAND", "TILE", "begin", "end", "pack", "product", "product_added", "store_operand"]
