"""Dense depth from sparse LiDAR and one image: without learning, or corrected by a network."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from eval.calibration import Tolerance
from priors.errors import DataError, UsageError, expect, expect_between, expect_choices
from priors.machine import threads
from priors.methods._completion_classical import EVERYWHERE_PX, clean_map, inverse_limits, list_samples, near_samples
from priors.methods._completion_classical import complete as complete
from priors.methods._network import Network
from priors.methods.lidar import Lidar
from priors.sky import doubt, sky_mask
from priors.types import Camera, Depth, Drive, FloatMap, Frame, Image, Input, Matrix, Method

FARTHEST_PX = 1 << 16
"""No image is that large: every pixel is reached."""
GENTLE = 2 / 3
"""Size of the lidar method's windows, as a share of its own, where samples are to be filled."""


@dataclass(frozen=True)
class Completion(Method):
    """Fill a sparse depth map, guided by the image."""

    source: Literal["auto", "velodyne_raw", "lidar"] = "auto"
    """Where the samples come from: the data set's own sparse maps, or the lidar method; auto: the former if there."""
    lidar: Lidar = field(default_factory=Lidar)
    """The lidar method's settings, where it is the source."""
    cleaning: Literal["gentle", "full"] = "gentle"
    """How the lidar method's test of occlusion looks for nearer surfaces. gentle: in smaller windows, which leave more
    samples at outlines, and for a single sweep with the scanner's place, and for a network without the test by stereo;
    full: as for its own maps."""
    guidance: float = 1.0
    """How much the image's brightness decides which sample a pixel follows; 0: only distance does."""
    reach_px: int = 64
    """Pixels farther than this from any sample (to within 4) get no value: the sky, mostly."""
    model: Literal["classical", "mffnet"] = "classical"
    """classical: no learning; mffnet: a network mends what that fills, and says how sure it is."""
    size: Literal["s", "m"] = "s"
    """Of the network: small is faster."""
    runtime: Literal["auto", "bf16", "fp32", "cuda", "onnx"] = "auto"
    """What runs the network; auto: CUDA where there is one, else what a table says is fastest on this CPU."""
    weights: Path | None = None
    """Your own weights for the network, .safetensors; default: those that come with the package."""

    VERSION: ClassVar[int] = 0 + Lidar.VERSION
    """Raised with lidar's, whose maps it fills: a sum, so that either makes a new one."""
    BEFORE: ClassVar[Mapping[str, Any]] = {"cleaning": "full"}

    def __post_init__(self) -> None:
        expect_choices(self, "completion.")
        expect(0 <= self.guidance < float("inf"), "--completion.guidance", self.guidance, "0 or more")
        expect_between(0, self.reach_px, FARTHEST_PX, "--completion.reach-px")
        if self.model == "classical" and self.weights is not None:
            raise UsageError(f"--completion.weights {self.weights}: of a network: ask for it by --completion.model")

    @property
    def reads(self) -> tuple[Input, ...]:
        """Return what a frame must have."""
        return ("image", "sparse" if self.source == "velodyne_raw" else "sweep")

    @property
    def network(self) -> Network | None:
        """Return the network that corrects the map; None for the classical method."""
        return None if self.model == "classical" else Network(self.model, self.size, self.runtime, self.weights)

    @property
    def sure_within(self) -> Tolerance | None:
        """Return what a network's confidence is the probability of; the classical method's is of nothing."""
        if self.network is None:
            return None
        from priors.methods._completion_network import WITHIN

        return Tolerance(WITHIN, "share")

    def unread(self) -> Mapping[str, str]:
        """Return the fields that these settings leave without effect: those of a network, and the lidar method's."""
        unread = {} if self.network else dict.fromkeys(("size", "runtime"), "--completion.model mffnet")
        if self.source == "velodyne_raw":
            unread |= dict.fromkeys(("lidar", "cleaning"), "--completion.source lidar")
        return unread

    @threads.limited(None)
    def resolve(self, frame: Frame) -> Self:
        """Return the config with the source and the runtime decided."""
        source = self.source
        if source == "auto":
            source = "velodyne_raw" if frame.has("sparse") else "lidar"
        network, resolved = self.network, replace(self, source=source, lidar=self.lidar.resolve(frame))
        if source == "velodyne_raw" or not (resolved.lidar.occlusion or resolved.lidar.sweeps == 1):
            resolved = replace(resolved, cleaning="full")  # it decides nothing
        elif self.cleaning == "gentle" and resolved.lidar.sweeps == 1 and network:
            resolved = replace(resolved, lidar=replace(resolved.lidar, stereo=False))  # what is wrong, it finds itself
        if network is None:
            return replace(resolved, size=type(self).size, runtime=type(self).runtime)  # they decide nothing
        if network.weights is not None and network.weights.suffix == ".onnx":
            raise DataError(f"{self.weights}: completion runs no ONNX files: name the network's .safetensors")
        return replace(resolved, runtime=network.decide_floating())

    def weights_digest(self) -> str | None:
        """Return the hash of the network's weights, for the cache's key; None for the classical method."""
        return None if self.network is None else self.network.digest()

    def prepare(
        self, drive: Drive, folder: Path, on_note: Callable[[str], None] = lambda line: None
    ) -> Callable[[Frame], Depth]:
        """Measure the drive's extrinsics where the lidar method's settings ask for it, and its sweeps are read."""
        if self.source == "velodyne_raw" or self.lidar.extrinsics == "calibration":
            return self
        correction, plain = (
            self.lidar.correction(drive, folder, on_note),
            replace(self, lidar=self.lidar.as_calibrated()),
        )
        return lambda frame: plain(correction.frame(frame))

    @threads.limited(None)
    def __call__(self, frame: Frame) -> Depth:
        """Make the dense map (height, width), metres along the camera's z axis; the sky's confidence is 0.

        Raises DataError where the drive has neither sparse maps nor a LiDAR, or the network's weights are missing.
        """
        config = self.resolve(frame)
        image, (sparse_m, T_cam_lidar) = frame.image(), config._samples(frame)
        return doubt(config.fill(sparse_m, image, frame.camera, T_cam_lidar), sky_mask(image))

    def _samples(self, frame: Frame) -> tuple[FloatMap, Matrix | None]:
        """Return the sparse map, and where its scanner stood; None where that is of no use.

        What several sweeps saw was seen from many places; it is cleaned of what the camera does not see.
        """
        if self.source == "velodyne_raw":
            return frame.sparse().depth_m, frame.T_cam_lidar
        if self.cleaning == "full":
            return self.lidar(frame).depth_m, None
        T_cam_lidar = frame.T_cam_lidar if self.lidar.sweeps == 1 else None
        return self.lidar.look(frame, GENTLE).depth_m, T_cam_lidar

    def fill(self, sparse_m: FloatMap, image: Image, camera: Camera, T_cam_lidar: Matrix | None = None) -> Depth:
        """Fill a sparse map (height, width), metres, as `complete` does; a network, if there is one, corrects it.

        Returns depth and confidence (height, width), both 0 where no sample is near.
        """
        given = sparse_m, image, camera, T_cam_lidar, self.guidance
        if self.network is None:
            return complete(*given, self.reach_px)
        from priors.methods._completion_network import correct

        net = self.network.open()
        filled = complete(*given, EVERYWHERE_PX)
        samples = list_samples(sparse_m)
        if not len(samples.inverse):
            return filled  # no sample, no value
        size = filled.depth_m.shape
        least, largest = inverse_limits(samples)
        limits_m = float(1 / largest), float(1 / least)
        near = near_samples(samples, size, self.reach_px)
        return correct(net, filled, clean_map(samples, size), image, near, limits_m)
