from nerf.config import FitConfig as FitConfig
from nerf.prepare import SceneConfig as SceneConfig
from nerf.run import Run as Run
from nerf.run import begin as begin
from nerf.run import open_run as open_run

__version__: str
