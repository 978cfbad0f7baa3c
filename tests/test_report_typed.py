"""The commands on a page: typed again, they ask for the same prior and the same run."""

import shlex
from pathlib import Path

import pytest
from factories import write_raw

from cli.arguments import parse
from cli.nerf.fit import FitArguments
from cli.priors.build import BuildArguments, _with_methods
from nerf.asked import RunConfig
from nerf.page import fit_command
from nerf.run import Run
from priors import build
from priors.report.typed import build_command


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_raw(tmp_path / "a drive's $HOME")


@pytest.mark.parametrize(
    "flags",
    [
        "--method lidar",
        "--method lidar --lidar.sweeps 3 --lidar.no-occlusion",
        "--method lidar --clip 33.25 --sky-rows 0.125 --density 0.3 --density-seed 5 --truth-mask",
        "--method completion --sky mask --confidence 0.5",
        "--method stereo --stereo.offset-px 0 0 0.25 --left-right 1.5 --keep 0.9228",
        "--method stereo --stereo.max-disparity-px 32 --stereo.model cfnet",
        "--method mono --camera image_02",
        "--method mono --mono.align scale --mono.align-to lidar --mono.runtime fp32",
    ],
)
def test_a_prior_s_command_asks_for_the_same_prior(drive: Path, tmp_path: Path, flags: str) -> None:
    first = asked(["build", str(drive), *shlex.split(flags), "--cache", str(tmp_path / "a cache")])
    again = asked(shlex.split(build_command(first.prior))[1:])
    assert again.prior.folder == first.prior.folder
    assert again.prior.manifest == first.prior.manifest


def asked(words: list[str]) -> build.Job:
    """What `priors` prepares for words that were typed after it."""
    args: BuildArguments = parse(_with_methods(), "priors build", "", words[1:])
    return build.prepare(args.open(), args.settings(str(args.method)), args.filters, args.cache)


@pytest.mark.parametrize(
    "flags",
    [
        "--steps 7 --views 5 --frames 0:2",
        "--time 90.5s --field mip360 --seed 3 --rays 256 --width 32",
        "--prior PRIOR --steps 3 --loss kl --depth-weight 0.25 --clip 30 --sky mask --keep 0.5 --views sparse",
        "--prior PRIOR --loss l1 --unit-m 2.5 --trim 0.25 --no-carve --density 0.2 --density-seed 4",
    ],
)
def test_a_run_s_command_asks_for_the_same_run(drive: Path, tmp_path: Path, flags: str) -> None:
    job = asked(["build", str(drive), "--method", "lidar", "--cache", str(tmp_path / "a cache")])
    words = [str(job.prior.folder) if word == "PRIOR" else word for word in shlex.split(flags)]
    run = Run(tmp_path / "runs" / "a b", config_of([str(drive), *words], job))
    again = shlex.split(fit_command(run))
    assert again[:2] == ["nerf", "fit"] and again[-2:] == ["--run", str(run.folder)]
    assert config_of(again[2:], job) == run.config


def config_of(words: list[str], job: build.Job) -> RunConfig:
    """What `nerf fit` asks for by words that were typed after it."""
    args = parse(FitArguments, "nerf fit", "", words)
    assert args.prior in (None, job.prior.folder.resolve(), job.prior.folder)
    return RunConfig.of(args.open(), args.prior and job.prior, args.scene(), args.config())
