"""The cache: depth maps in files that a stranger can read and write (docs/cache.md).

    cache/<drive>/<method>-<key>/manifest.json          what made it (manifest.py)
                                /depth/<id>.png         uint16, metres x 256, rounded, 0 = no value
                                /confidence/<id>.png    uint16, confidence x 65535 (8 bits are read too)
                                /consistency/<id>.png   the same: a second confidence, where somebody made one
                                /confidence_relative/<id>.png  the same: the probability of an error within 5 %
                                /frames.jsonl           one line a computed frame (journal.py, sources.py)
                                /learned/<name>.json    what was read of other frames before the first map (learned.py)
                                /claims/<id>            who computes it just now (priors/owner)

The key (priors/keys.py) is a hash of everything that decides what the maps hold, so a changed parameter is another
folder and never an old map. A depth file is the mark that its frame is done: it is renamed into place last.
"""

from priors.cache.manifest import FORMAT as FORMAT
from priors.cache.places import find as find
from priors.cache.places import holds_priors as holds_priors
from priors.cache.places import only as only
from priors.cache.prior import Prior as Prior
from priors.cache.prior import create as create
from priors.cache.prior import load as load
