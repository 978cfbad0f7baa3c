"""Budget: the most accurate method for a time, or the fastest for an error."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from priors.bench.candidates import Candidate, most_accurate
from priors.errors import DataError, UsageError

TIME = re.compile(r"(\d+(?:\.\d+)?)(ms|s)")
ERROR = re.compile(r"absrel=(\d+(?:\.\d+)?|\.\d+)", re.IGNORECASE)


@dataclass(frozen=True)
class Budget:
    """What a frame may take, or how far off it may be: one of the two."""

    seconds: float | None = None
    """Wall time of a frame."""
    abs_rel: float | None = None
    """Mean relative error."""

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read 100ms, 2s or absrel=0.02; UsageError where it is none of them."""
        if found := TIME.fullmatch(text):
            made = cls(seconds=float(found[1]) * (1e-3 if found[2] == "ms" else 1.0))
        elif found := ERROR.fullmatch(text):
            made = cls(abs_rel=float(found[1]))
        else:
            wanted = "the time of a frame, as 100ms or 2s, or an error, as absrel=0.02"
            raise UsageError(f"--budget {text or repr(text)}: expected {wanted}")
        if not any((made.seconds, made.abs_rel)):
            raise UsageError(f"--budget {text}: expected more than 0")
        return made

    def __str__(self) -> str:
        return f"absrel={self.abs_rel:g}" if self.abs_rel is not None else told(self.seconds or 0.0)

    def choose(self, among: Sequence[Candidate], named: bool = False) -> Candidate:
        """Choose for a time the most accurate that keeps to it; for an error the fastest.

        Args:
            among: what can be built.
            named: whether the user named the method; else only dense maps are chosen.

        Raises:
            DataError: nothing meets it; the fastest, or the most accurate, is named with its figure.
        """
        every = [each for each in among if named or each.dense]
        if not every:
            raise DataError(f"--budget {self}: nothing here makes dense maps: name a method by --method")
        if self.seconds is not None:
            return self._in_time(every)
        return self._as_right(every)

    def _in_time(self, among: Sequence[Candidate]) -> Candidate:
        kept = [each for each in among if each.seconds <= (self.seconds or 0.0)]
        if not kept:
            fastest = min(among, key=lambda each: each.seconds)
            times = f"the fastest is {fastest.name}, {told(fastest.seconds)} a frame ({fastest.source})"
            raise DataError(f"--budget {self}: nothing is as fast: {times}: {_command(fastest)}")
        return most_accurate(kept) or min(kept, key=lambda each: each.seconds)

    def _as_right(self, among: Sequence[Candidate]) -> Candidate:
        kept = [each for each in among if each.abs_rel <= (self.abs_rel or 0.0)]
        if kept:
            return min(kept, key=lambda each: each.seconds)
        best = most_accurate(among)
        if best is None:
            raise DataError(f"--budget {self}: no error is known here: run `priors bench` with a truth first")
        figures = f"AbsRel {best.abs_rel:.4f}, {told(best.seconds)} a frame ({best.source})"
        fastest = min(among, key=lambda each: each.seconds)
        others = f"; the fastest is {fastest.name}, {told(fastest.seconds)}" if fastest is not best else ""
        raise DataError(
            f"--budget {self}: nothing is as right: the best is {best.name}, {figures}{others}: {_command(best)}"
        )


def told(seconds: float) -> str:
    """Write a frame's time: 85 ms, 1.2 s."""
    return f"{1e3 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.3g} s"


def _command(candidate: Candidate) -> str:
    return " ".join(candidate.flags())
