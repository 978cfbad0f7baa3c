"""Imports: depth maps that other programs made, as a prior in the cache.

    prepare(drive, Path("maps"), Encoding("1/256", "depth"), Path("cache")).run()

They are joined to frames by their names, turned into camera-z metres, compared with what else measures depth, and
written as every prior is. `priors import` does the same.
"""

from priors.imported.encoding import Encoding as Encoding
from priors.imported.make import Import as Import
from priors.imported.make import ImportReport as ImportReport
from priors.imported.make import prepare as prepare
