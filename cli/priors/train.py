"""`priors train`: render samples, train the networks, pack what they learned."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from cli.arguments import Device, parse
from cli.console import busy, err, out, progress, train_progress
from cli.mistakes import nearest
from priors.errors import DataError, UsageError, expect, expect_between
from priors.learn.config import TrainConfig
from priors.machine.device import pick_device
from priors.selection import parse_shard

if TYPE_CHECKING:
    from priors.learn.training_run import Task

LARGEST_PACK_MIB = 100_000
EXAMPLES = """Train the networks on your own data. Every run stops (Ctrl-C, kill) and goes on with the same command.

examples:
  priors train samples samples/ --count 4800            synthetic pairs with exact truth; --part 1/2 for two machines
  priors train stereo runs/cfnet-s --street samples/ --net cfnet --size s --minutes 90
  priors train stereo runs/cfnet-s --street samples/ --real DATA --minutes 240
  priors train completion runs/mffnet --street samples/ --real DRIVE
  priors train completion runs/mine --street samples/ --real DRIVE --start mffnet-s.safetensors --lr 0.0005
  priors train mono runs/bts --street samples/
  priors train pack-crops crops/ --street samples/ --real DATA    what training needs in 36 MiB, for a borrowed GPU
  priors train mono runs/bts --crops crops/ --size m --start bts-m.safetensors --device cuda --batch 16
  priors train pack runs/cfnet-s cfnet-s.safetensors    what `--stereo.weights` takes
  priors train calibrate cfnet-s.safetensors --street samples/    stereo's confidence, from what training held back
  priors train calibrate mffnet-s.safetensors --street samples/ --real DATA    up to which density completion counts
  priors train surfaces cfnet-s.safetensors --street samples/ --real DATA    stereo's surface where it is unsure
  priors train choice mffnet-s.safetensors --street samples/ --real DATA    completion's depth where it is unsure

--help after any of these tells the rest"""


@dataclass(frozen=True)
class SamplesArguments:
    """Arguments of `priors train samples`."""

    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    """Folder to write samples into; what is there is kept."""
    count: int = 4800
    """Samples the folder is to hold, 1.3 MB each."""
    part: str = "1/1"
    """i/n: the i-th of n machines' share."""

    def __post_init__(self) -> None:
        expect_between(1, self.count, 10**7, "--count")
        parse_shard(self.part, "--part")


@dataclass(frozen=True)
class RunArguments:
    """What training any network takes."""

    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    """The run's folder: checkpoint, log.jsonl, pictures/. A run that is there goes on."""
    street: Path = Path("samples")
    """Folder of `priors train samples`."""
    real: Path | None = None
    """Real data to learn from too: a folder that holds kitti_odometry, kitti_raw_train, camvid or some of them."""
    crops: Path | None = None
    """Pack of `priors train pack-crops`, in place of --street and --real."""
    size: Literal["s", "m", "l"] = "s"
    """The network's size."""
    batch: int = 2
    """Crops in a step."""
    device: Device = "auto"
    """Where to train; auto: a GPU where there is one."""
    start: Path | None = None
    """Weights to start from: those of the tensors that this network has too. A stereo network's stages then all learn
    from the first step; mono does without ImageNet's."""
    how: tyro.conf.OmitArgPrefixes[TrainConfig] = field(default_factory=TrainConfig)

    def __post_init__(self) -> None:
        expect_between(1, self.batch, 4096, "--batch")
        if self.crops is not None and self.real is not None:
            raise UsageError(f"--crops {self.crops} stands in place of --real {self.real}: leave one of them out")


@dataclass(frozen=True)
class StereoArguments(RunArguments):
    """Arguments of `priors train stereo`."""

    net: Literal["cfnet", "pcwnet"] = "cfnet"
    """Which network."""
    cache: Path | None = None
    """Where prepared real data is kept; default: `real` beside the samples."""
    teacher: Path | None = None
    """Folder of a teacher's maps of the odometry frames, see `python -m priors.learn.teacher_labels --help`."""


@dataclass(frozen=True)
class PackArguments:
    """Arguments of `priors train pack`."""

    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Folder of a training run."""
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    """File to write: .safetensors."""


@dataclass(frozen=True)
class PackCropsArguments:
    """Arguments of `priors train pack-crops`."""

    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    """Folder to write crops into; those that are there are kept."""
    street: Path = Path("samples")
    """Folder of `priors train samples`."""
    real: Path | None = None
    """Real data, as in training; what is held back is packed for validation alone."""
    mib: float = 36.0
    """Room for all files together, MiB."""

    def __post_init__(self) -> None:
        expect(0 < self.mib < LARGEST_PACK_MIB, "--mib", self.mib, f"more than 0, less than {LARGEST_PACK_MIB}")


@dataclass(frozen=True)
class CalibrateArguments:
    """Arguments of `priors train calibrate`."""

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """Weights of a stereo or completion network; their header is rewritten."""
    street: Path = Path("samples")
    """Folder of `priors train samples`."""
    real: Path | None = None
    """Real data, as in training."""
    cache: Path | None = None
    """Where prepared real data is kept, as in training."""


@dataclass(frozen=True)
class ChoiceArguments:
    """Arguments of `priors train choice`."""

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """Weights of a completion network, calibrated; their header is rewritten."""
    street: Path = Path("samples")
    """Folder of `priors train samples`."""
    real: Path | None = None
    """Real data, as in training."""


@dataclass(frozen=True)
class SurfacesArguments:
    """Arguments of `priors train surfaces`."""

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """Weights of a stereo network, calibrated; their header is rewritten."""
    street: Path = Path("samples")
    """Folder of `priors train samples`."""
    real: Path | None = None
    """Real data, as in training."""
    cache: Path | None = None
    """Where prepared real data is kept, as in training."""
    wide: bool = False
    """Also offer planes continued and the first sure pixel on each side: for networks that fail on whole walls."""


def run(arguments: list[str]) -> int:
    """Train; returns the exit code."""
    if not arguments or arguments[0] in ("-h", "--help"):
        out.print(EXAMPLES)
        return 0
    name, rest = arguments[0], arguments[1:]
    if name not in KINDS:
        raise UsageError(f"priors train {name}: expected one of {', '.join(KINDS)}{nearest(name, list(KINDS))}")
    kind, command = KINDS[name]
    command(parse(kind, f"priors train {name}", EXAMPLES, rest))
    return 0


def render_samples(args: SamplesArguments) -> None:
    """Render samples of procedural streets."""
    from priors.learn.street_samples import render

    with progress("samples", args.count) as step:
        render(args.out, args.count, step, args.part)
    out.print(f"wrote {args.out}")


def stereo_task(args: StereoArguments) -> "Task":
    """Make what a stereo network learns."""
    import torch

    from priors.learn.crop_pack import CropPack
    from priors.learn.stereo import SCHEDULE, StereoTask
    from priors.learn.stereo_data import Folders, mixture, packed_mixture, packed_validation, validation
    from priors.nets import runtime

    torch.manual_seed(0)
    net = runtime.create(args.net, args.size)
    schedule = (0, 0) if started_from(args) else SCHEDULE  # what has learned already learns on as a whole
    if args.crops is not None:
        crops = CropPack(args.crops)
        return StereoTask(net, packed_mixture(crops), packed_validation(crops), args.batch, schedule)
    folders = Folders(args.street, args.real, args.cache, args.teacher)
    return StereoTask(net, mixture(folders), validation(folders, count=10), args.batch, schedule)


def completion_task(args: RunArguments) -> "Task":
    """Make what the completion network learns."""
    from priors.learn.completion import CompletionConfig, CompletionTask

    return CompletionTask(CompletionConfig(args.street, args.real, args.crops, batch=args.batch, size=args.size))


def mono_task(args: RunArguments) -> "Task":
    """Make what the single-image network learns."""
    from priors.learn.mono import MonoConfig, MonoTask

    cache, imagenet = args.out / "cache", not started_from(args)
    return MonoTask(MonoConfig(args.street, args.real, cache, args.crops, imagenet, batch=args.batch, size=args.size))


def started_from(args: RunArguments) -> str | None:
    """Return the name of the weights that a run starts from, or that it started from where it goes on; None: none."""
    from priors.learn.checkpoint import about_run

    return about_run(args.out).get("start") if args.start is None else args.start.name


def train_network(args: Any, make_task: Callable[[Any], "Task"], net: str) -> None:
    """Train and tell how to use the result."""
    from priors.learn.loop import train
    from priors.nets import weights

    with busy("reading the training data"):
        task = make_task(args)
    if args.start is not None:
        err.print(f"{weights.take(task.net, args.start)} tensors taken from {args.start}")
    about = {"net": net, "size": args.size, "start": started_from(args)}
    with train_progress(args.out.name) as on_step:
        last = train(task, args.out, args.how, about, pick_device(args.device), on_step)
    for name, value in last.items():
        out.print(f"{name:<28}{value:.4f}")
    out.print(f"wrote {args.out}; next: priors train pack {args.out} {net}-{args.size}.safetensors")


def pack(args: PackArguments) -> None:
    """Write a run's best weights as a file that methods take."""
    from priors.learn.checkpoint import pack_run

    pack_run(args.run, args.out)
    out.print(f"wrote {args.out} ({args.out.stat().st_size / 1e6:.1f} MB)")


def pack_crops(args: PackCropsArguments) -> None:
    """Write a pack of training crops."""
    from priors.learn.crop_packing import PackRequest, pack_crops

    with progress("crops, % of the room", 100) as step:
        counts = pack_crops(PackRequest(args.out, args.street, args.real, args.mib), step)
    for name, count in counts.items():
        out.print(f"{name:<12}{count}")
    out.print(f"wrote {args.out}")


def calibrate(args: CalibrateArguments) -> None:
    """Fit a stereo network's confidence, or a completion network's densities, to what training held back."""
    from priors.learn import completion_gate, confidence_calibration
    from priors.learn.stereo_data import Folders
    from priors.nets import weights

    net = weights.read_about(args.file).get("net")
    with busy("calibrating"):
        if net == "mffnet":
            lines = completion_gate.calibrate_file(args.file, args.street, args.real)
        elif net in STEREO:
            lines = confidence_calibration.calibrate_file(args.file, Folders(args.street, args.real, args.cache))
        else:
            raise DataError(
                f"{args.file}: of {net}, which has nothing to calibrate: a stereo or completion network has"
            )
    for line in lines:
        out.print(line)


def fit_surfaces(args: SurfacesArguments) -> None:
    """Fit which of the surfaces around a pixel a stereo network chooses where it is unsure."""
    from priors.learn import surface_fit
    from priors.learn.stereo_data import Folders
    from priors.nets import weights

    net = weights.read_about(args.file).get("net")
    if net not in STEREO:
        raise DataError(f"{args.file}: of {net}, which does not match: a stereo network chooses among surfaces")
    with busy("fitting the choice of surfaces"):
        lines = surface_fit.fit_file(args.file, Folders(args.street, args.real, args.cache), wide=args.wide)
    for line in lines:
        out.print(line)


def fit_choice(args: ChoiceArguments) -> None:
    """Fit which depth a completion network's pixel gets where it is unsure."""
    from priors.learn import choice_fit
    from priors.nets import weights

    net = weights.read_about(args.file).get("net")
    if net != "mffnet":
        raise DataError(f"{args.file}: of {net}, which completes nothing: a completion network chooses among depths")
    with busy("fitting the choice of depths"):
        lines = choice_fit.fit_file(args.file, args.street, args.real)
    for line in lines:
        out.print(line)


STEREO = ("cfnet", "pcwnet")
"""Networks whose confidence is calibrated."""
KINDS: dict[str, tuple[type[Any], Callable[[Any], None]]] = {
    "samples": (SamplesArguments, render_samples),
    "stereo": (StereoArguments, lambda args: train_network(args, stereo_task, args.net)),
    "completion": (RunArguments, lambda args: train_network(args, completion_task, "mffnet")),
    "mono": (RunArguments, lambda args: train_network(args, mono_task, "bts")),
    "pack": (PackArguments, pack),
    "pack-crops": (PackCropsArguments, pack_crops),
    "calibrate": (CalibrateArguments, calibrate),
    "surfaces": (SurfacesArguments, fit_surfaces),
    "choice": (ChoiceArguments, fit_choice),
}
"""What follows `priors train`: its arguments and what it does."""
ARGUMENTS = {f"priors train {name}": kind for name, (kind, _) in KINDS.items()}
