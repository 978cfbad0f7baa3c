"""The script for a borrowed GPU, rehearsed on the CPU with a tiny drive: what is done, cut, failed and kept."""

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch
from factories import write_raw
from safetensors.torch import load_file
from test_learn_completion import write_samples

from cli.priors import PROGRAM
from priors.learn.crop_packing import PackRequest, pack_crops

SCRIPT = Path(__file__).with_name("bench") / "gpu"
Answer = tuple[int, dict[str, Any], str]


def call(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def measured(pack: Path, out: Path, *arguments: object) -> Answer:
    """Run parts on the CPU; return the exit code, the record and the summary."""
    done = call("--pack", pack, "--out", out, "--device", "cpu", *arguments)
    assert (out / "results.json").exists(), done.stdout + done.stderr
    return done.returncode, json.loads((out / "results.json").read_text()), (out / "summary.md").read_text()


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pack of a drive of 12 frames."""
    folder = tmp_path_factory.mktemp("gpu")
    write_raw(folder / "raw", range(12))
    done = call("--make-pack", "--data", folder / "raw", "--pack", folder / "pack")
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "pack"


def test_a_pack_holds_the_left_eye_the_prior_and_the_held_out_truth(pack: Path) -> None:
    names = {str(path.relative_to(pack)).split("/")[0] for path in pack.rglob("*") if path.is_file()}
    assert names == {"drive", "prior", "truth", "pack.json"}
    assert [path.name for path in (pack / "truth").iterdir()] == ["0000000009.png"]
    assert len(list((pack / "prior").glob("*/stereo-*/depth/*.png"))) == 12
    assert not [path for path in pack.rglob("*") if path.name in ("image_03", "velodyne_points")]
    assert "made already" in call("--make-pack", "--data", "nowhere", "--pack", pack).stdout


@pytest.mark.slow
def test_a_rehearsal_measures_every_part(pack: Path, tmp_path: Path) -> None:
    """The budget is so short that steps are few, and long enough for a busy core."""
    before = sorted(pack.rglob("*"))
    code, record, summary = measured(pack, tmp_path, "--budget", 220, "--crops", tmp_path / "none")
    parts = record["parts"]
    assert list(parts) == ["machine", "checks", "bench", "splat", "fit", "train"]
    # A busy core may be too slow for a part's share: then it is cut, with what it had by then.
    assert {part["state"] for part in parts.values()} <= {"done", "cut"}, summary
    assert code == 0
    assert parts["machine"]["figures"]["modules"]["torch"]
    assert parts["checks"]["figures"]["passed"] >= 1
    assert parts["bench"]["figures"]["2^14 rows, 64 neurons"]["M samples/s"] > 0
    gaussians = parts["splat"]["figures"]
    assert gaussians["ours, 124x37, 2000 Gaussians"]["both ms"] > 0
    assert gaussians["apart from the twin, rgb"] < 1e-4
    assert next(value for name, value in gaussians.items() if name.startswith("fit,"))["psnr"] > 5
    scored = parts["fit"]["figures"]["1024 rays, 40 steps"]
    assert scored["psnr"] > 5 and scored["abs_rel"] < 1 and scored["steps"] == 40
    assert "no crops here" in summary
    assert "says anything about" in summary
    assert sorted(pack.rglob("*")) == before, "the pack must not grow: it travels"
    files = list(tmp_path.iterdir())
    assert {path.name for path in files} == {"results.json", "summary.md", "log.txt", "view.png"}
    assert sum(path.stat().st_size for path in files) < 16 << 20


@pytest.mark.slow
def test_a_rehearsal_trains_each_network_and_goes_on(tmp_path: Path) -> None:
    """Weights come out, finite, of the networks that ship; a second call goes on, and a build takes what it wrote."""
    crops, runs, out = tmp_path / "crops", tmp_path / "runs", tmp_path / "out"
    pack_crops(PackRequest(crops, write_samples(tmp_path), None, 36))
    places = ("--crops", crops, "--runs", runs, "--parts", "train")
    code, record, summary = measured(tmp_path, out, *places, "--budget", 200, "--train-s", 4)
    assert code == 0 and record["parts"]["train"]["state"] == "done", summary
    for name in ("cfnet-s", "mffnet-s", "bts-m"):
        weights = load_file(out / f"{name}.safetensors")
        assert all(torch.isfinite(value.float()).all() for value in weights.values())
        assert (out / f"{name}.safetensors").stat().st_size < 16 << 20
        assert any("validation" in line for line in (out / f"{name}.jsonl").read_text().splitlines())
        found = record["parts"]["train"]["figures"][name]
        assert found["error, best"] <= found["error, start"], "weights that are worse than the start are not kept"
    first = json.loads((runs / "mffnet-s" / "last.json").read_text())
    again = (*places, "--budget", 90, "--train-s", first["seconds"] + 8, "--networks", "mffnet")
    assert measured(tmp_path, out, *again)[0] == 0
    assert json.loads((runs / "mffnet-s" / "last.json").read_text())["step"] > first["step"]
    folder = write_raw(tmp_path / "raw", range(1))
    build = ["build", str(folder), "--cache", str(tmp_path / "cache"), "--frames", "0:1", "--method"]
    assert (
        PROGRAM.run([*build, "stereo", "--stereo.model", "cfnet", "--stereo.weights", str(out / "cfnet-s.safetensors")])
        == 0
    )
    assert PROGRAM.run([*build, "mono", "--mono.weights", str(out / "bts-m.safetensors")]) == 0


def test_without_crops_a_line_says_how_to_make_them(tmp_path: Path) -> None:
    code, _, summary = measured(tmp_path, tmp_path / "out", "--crops", tmp_path / "none", "--parts", "train")
    assert code == 0 and "no crops here: make gpu-crops" in summary


@pytest.mark.slow
def test_a_part_that_runs_over_is_cut_and_what_it_had_is_kept(pack: Path, tmp_path: Path) -> None:
    """The part starts a child that would go on for long: both are ended."""
    child = tmp_path / "child.py"
    alive = tmp_path / "alive"
    child.write_text(
        f"""import time\nprint('{{"loss": 0.5}}', flush=True)\ntime.sleep(20)\nopen({str(alive)!r}, 'w')\n"""
    )
    train = f"{sys.executable} {child}"
    arguments = ("--budget", 14, "--parts", "train", "--train", train)
    code, record, summary = measured(pack, tmp_path / "out", *arguments)
    part = record["parts"]["train"]
    assert part["state"] == "cut", summary
    assert part["figures"]["loss"] == 0.5
    assert part["seconds"] < 18
    assert "**Cut**" in summary and "- loss: 0.5" in summary
    assert code == 0
    time.sleep(max(0.0, 21 - part["seconds"]))
    assert not alive.exists()


def test_a_part_that_fails_stops_no_other_and_says_why(tmp_path: Path) -> None:
    train = f"{sys.executable} -c \"raise ValueError('out of luck')\""
    code, record, summary = measured(tmp_path / "none", tmp_path / "out", "--parts", "fit", "train", "--train", train)
    assert {name: part["state"] for name, part in record["parts"].items()} == {
        "machine": "done",
        "fit": "failed",
        "train": "failed",
    }
    assert "no pack here" in summary
    assert "ValueError: out of luck" in summary
    assert code == 1


def test_without_a_gpu_one_line_says_so(tmp_path: Path) -> None:
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    done = call("--pack", tmp_path, "--out", tmp_path / "out", "--device", "cuda")
    assert done.returncode == 1
    assert "finds no CUDA device" in done.stdout
    assert done.stdout.count("there is no GPU to run on") == 10, "five parts, in the log and in the summary"
