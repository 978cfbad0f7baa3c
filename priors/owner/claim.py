"""Claims: a small file says who has something in hand. It is touched every 10 s, and dead when that stops.

    with claim.hold(run.folder / ".owner", what=str(run.folder), by_launch=True) as held:     DataError: another has it
        ...
        if held.lost: ...             another took it, because this process stood still for more than a minute

    held = claim.take(claims / frame_id)       None where another has it: leave it to that one
    ...
    held.release()

An owner is a host, a process and a heartbeat. A claim is dead when its file was not touched for DEAD_S, and at once
where its process ended on this host. A dead claim is anybody's. With `by_launch`, processes of one launch (`WORLD_SIZE`
above 1) are one owner: each of them gets the claim.
"""

import fcntl
import json
import os
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from eval.errors import DataError
from priors.owner.process import Process, me, restore

BEAT_S = 10.0
"""A held claim is touched as often as that."""
DEAD_S = 60.0
"""A claim that was not touched for so long is dead."""

TRIES = 20
"""An empty folder of claims may be deleted by another process while a claim is made in it: then it is made again."""


@dataclass(frozen=True)
class Owner:
    """What a claim's file says of who has it."""

    process: Process | None
    """None where the file cannot be read: only its age tells then."""
    token: str
    """Another one for each claim, so that two of one process differ."""
    silent_s: float
    """Since the last heartbeat, seconds."""

    @property
    def alive(self) -> bool:
        """Whether the claim still holds."""
        if abs(self.silent_s) > DEAD_S or (self.process is not None and self.process.has_ended):
            return False
        return not (self.process is not None and self.process.is_me and self.token not in _held)

    def __str__(self) -> str:
        who = "another process" if self.process is None else str(self.process)
        return f"{who}, last sign of life {max(self.silent_s, 0):.0f} s ago"


@dataclass
class Claim:
    """Something that this process has in hand, until `release`."""

    path: Path
    token: str = field(default_factory=lambda: uuid.uuid4().hex)
    lost: bool = False
    """Whether another owner has it now: this process did not touch it for DEAD_S, or the file was deleted."""

    def release(self) -> None:
        """Give it back; what another has taken meanwhile is left alone."""
        _held.pop(self.token, None)
        with _alone(self.path.parent):
            owner = _read(self.path)
            if owner is not None and owner.token == self.token:
                with suppress(OSError):
                    self.path.unlink(missing_ok=True)

    def beat(self) -> None:
        """Touch the file; tells in `lost` whether it is another's now."""
        owner = _read(self.path)
        if owner is None or not (owner.token == self.token or (owner.process and owner.process.is_partner)):
            self.lost = True
            return
        with suppress(OSError):  # a full or unreachable disk: others will take it for dead, no harm is done here
            os.utime(self.path)

    def __enter__(self) -> "Claim":
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


_held: dict[str, Claim] = {}
_starting = threading.Lock()
_beating: tuple[int, threading.Thread] | None = None


def take(path: Path, *, by_launch: bool = False) -> Claim | None:
    """Claim what a file stands for; None where another owner has it.

    Args:
        path: the claim's file; its folder is made where there is none.
        by_launch: whether all processes of this process's launch may have it together.

    Raises:
        OSError: the folder cannot be written.
    """
    claim = Claim(path)
    _held[claim.token] = claim
    try:
        owned = _create(claim) or (by_launch and _join(claim)) or _replace(claim)
    except BaseException:
        _held.pop(claim.token, None)
        raise
    if not owned:
        _held.pop(claim.token, None)
        return None
    _start_beating()
    return claim


@contextmanager
def hold(path: Path, what: str, *, by_launch: bool = False) -> Iterator[Claim]:
    """Claim what a file stands for while the block runs.

    Args:
        path: the claim's file.
        what: what is claimed, for the error.
        by_launch: whether all processes of this process's launch may have it together.

    Raises:
        DataError: another owner has it; the one line names that.
        OSError: the folder cannot be written.
    """
    claim = take(path, by_launch=by_launch)
    if claim is None:
        raise DataError(f"{what}: {owner_of(path) or 'another process'} has it in hand: wait for it, or stop it")
    with claim:
        yield claim


def owner_of(path: Path) -> Owner | None:
    """Return who has what a file stands for; None where nobody has it, or the claim is dead."""
    owner = _read(path)
    return owner if owner is not None and owner.alive else None


def is_dead(path: Path) -> bool:
    """Tell whether a claim was left behind by an owner that ended before it gave back."""
    owner = _read(path)
    return owner is not None and not owner.alive


def _create(claim: Claim) -> bool:
    """Make the claim's file, whole or not at all; False where there is one."""
    text = json.dumps({"token": claim.token, **me(os.getpid()).record()})
    vanishing: OSError | None = None
    for _ in range(TRIES):
        temporary = claim.path.with_name(f".{claim.token}.claim")
        try:
            claim.path.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_text(text, encoding="utf-8")
            return _link(temporary, claim.path)
        except (FileNotFoundError, FileExistsError) as error:  # mkdir: it was there, and is gone when that is looked at
            vanishing = error
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(claim.path)) from error
        finally:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
    assert vanishing is not None
    raise OSError(vanishing.errno, vanishing.strerror, str(claim.path.parent)) from vanishing


def _link(temporary: Path, path: Path) -> bool:
    """Give a whole file its name, unless there is one of that name."""
    try:
        os.link(temporary, path)
        return True
    except (FileExistsError, FileNotFoundError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        return False
    except OSError:  # a file system without hard links
        try:
            with path.open("x") as file:
                file.write(temporary.read_text("utf-8"))
            return True
        except FileExistsError:
            return False


def _join(claim: Claim) -> bool:
    """Tell whether a living process of the same launch has it: then this one has it too."""
    owner = owner_of(claim.path)
    return owner is not None and owner.process is not None and owner.process.is_partner and not owner.process.is_me


def _replace(claim: Claim) -> bool:
    """Take a dead claim over; False where a living owner has it."""
    if owner_of(claim.path) is not None:
        return False
    with _alone(claim.path.parent):  # of several who see it dead, the first gets it
        if owner_of(claim.path) is not None:
            return False
        claim.path.unlink(missing_ok=True)
        return _create(claim)


def _read(path: Path) -> Owner | None:
    """Read a claim's file; None where there is none."""
    try:
        touched_s, text = path.stat().st_mtime, path.read_text("utf-8")
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError):
        return Owner(None, "", 0.0)
    try:
        record = json.loads(text)
        token = str(record.pop("token"))
        process = restore(record)
    except (ValueError, KeyError, TypeError, AttributeError):
        token, process = "", None
    silent_s = time.time() - touched_s
    if process is not None and process.host != me(os.getpid()).host:
        silent_s = _age(path.parent, touched_s, silent_s)
    return Owner(process, token, silent_s)


def _age(folder: Path, touched_s: float, by_our_clock_s: float) -> float:
    """Return how long ago the file server says that a file was touched: another host's clock may be off."""
    probe = folder / f".{uuid.uuid4().hex}.clock"
    try:
        probe.touch()
        return probe.stat().st_mtime - touched_s
    except OSError:
        return by_our_clock_s
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Let one process at a time judge and replace claims of a folder; file systems without locks go without."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        yield
        return
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _start_beating() -> None:
    """Let a thread of this process touch what it holds; it ends when nothing is held."""
    global _beating
    with _starting:
        if _beating is None or _beating[0] != os.getpid() or not _beating[1].is_alive():
            thread = threading.Thread(target=_beat, name="heartbeat", daemon=True)
            _beating = os.getpid(), thread
            thread.start()


def _beat() -> None:
    global _beating
    while True:
        time.sleep(BEAT_S)
        for claim in list(_held.values()):
            claim.beat()
        with _starting:
            if not _held:
                _beating = None
                return
