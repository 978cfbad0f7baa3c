from priors.cache import Prior as Prior
from priors.draw.notebook import depth_html as depth_html
from priors.drives import open_drive as open_drive
from priors.errors import DataError as DataError
from priors.filters import Filters as Filters
from priors.methods.completion import Completion as Completion
from priors.methods.lidar import Lidar as Lidar
from priors.methods.mono import Mono as Mono
from priors.methods.stereo import Stereo as Stereo
from priors.types import Camera as Camera
from priors.types import Depth as Depth
from priors.types import Drive as Drive
from priors.types import Frame as Frame
from priors.types import Method as Method

__version__: str
