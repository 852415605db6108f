"""A line about the progress of a long call, on terminals and in notebooks."""

from __future__ import annotations

import sys
import threading
import time
from typing import Any, Callable, TextIO

_DELAY = 2.0  # s, before the first line
_INTERVAL = 0.2  # s, between lines
_WIDTH = 100  # characters of a line
_line = threading.Lock()  # held by what writes lines: a call within another one, or beside it, writes none


def _is_notebook() -> bool:
    """Returns whether this is a kernel of Jupyter, whose cells show what is written to stderr."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return shell is not None and type(shell).__name__ == "ZMQInteractiveShell"


def bar(done: int, total: int, width: int = 20) -> str:
    """Returns a bar with the number of units of work that are done, of all."""
    full = width * done // max(total, 1)
    return f"[{'=' * full}{' ' * (width - full)}] {done}/{total}"


class Progress:
    """While it is entered, a thread writes a line about the progress to stderr, after two seconds, over the one before.

    Args:
        name: of what is at work.
        shown: True: the line is written; False: it is not; None: it is, if stderr is a terminal or this is a notebook.
        total: number of units of work; 0: not known.
        out: where the line is written; default: stderr.
    """

    def __init__(self, name: str, shown: bool | None, total: int = 0, out: TextIO | None = None,
                 delay: float | None = None):
        if shown not in (None, True, False):
            raise TypeError(f"progress: found {type(shown).__name__}, expected True, False or None")
        self._out = sys.stderr if out is None else out
        wanted = self._out is not None and (self._out.isatty() or _is_notebook()) if shown is None else bool(shown)
        self.shown = wanted and self._out is not None
        self._name, self._total, self._delay = name, total, _DELAY if delay is None else delay
        self._done, self._text, self._width = 0, "", 0
        self._end = threading.Event()
        self._thread: threading.Thread | None = None

    def advance(self, done: int, text: str = "") -> None:
        """Takes note of the number of units that are done."""
        self._done, self._text = done, text

    def callback(self, callback: Callable[[int, float], Any] | None) -> Callable[[int, float], Any] | None:
        """Returns a callback of a solver that takes note of iterations and calls `callback`."""
        if not self.shown:
            return callback

        def noted(iteration: int, loss: float) -> Any:
            self.advance(iteration, f"loss {loss:.7g}")
            return None if callback is None else callback(iteration, loss)

        return noted

    def status(self, status: Callable[[str], None] | None) -> Callable[[str], None] | None:
        """Returns a function that takes note of a text and calls `status`."""
        if not self.shown:
            return status

        def noted(text: str) -> None:
            self._text = text
            if status is not None:
                status(text)

        return noted

    def __enter__(self) -> Progress:
        self.shown = self.shown and _line.acquire(blocking=False)
        if self.shown:
            self._thread = threading.Thread(target=self._write_lines, daemon=True)
            self._thread.start()
        return self

    def __exit__(self, *error: Any) -> None:
        if self._thread is not None:
            self._end.set()
            self._thread.join()
            _line.release()

    def _write_lines(self) -> None:
        begin = time.monotonic()
        if self._end.wait(self._delay):
            return
        while True:
            self._write_line(time.monotonic() - begin)
            if self._end.wait(_INTERVAL):
                break
        self._clear_line()

    def _write_line(self, seconds: float) -> None:
        done = bar(self._done, self._total) if self._total else ""
        parts = [part for part in (done, f"{seconds:.0f} s", self._text) if part]
        line = f"{self._name}: {', '.join(parts)}"[:_WIDTH]
        self._out.write("\r" + line.ljust(self._width))
        self._out.flush()
        self._width = len(line)

    def _clear_line(self) -> None:
        self._out.write("\r" + " " * self._width + "\r")
        self._out.flush()


class CountedProgress(Progress):
    """The progress of a call that may be much shorter than the start of a thread: what computes writes the line itself, with
    ``counter``, a function of seconds and of the numbers of units that are done and of all; None if no line is wanted."""

    @property
    def counter(self) -> Callable[[float, int, int], None] | None:
        return self._count if self.shown else None

    def _count(self, seconds: float, done: int, total: int) -> None:
        if self._width or _line.acquire(blocking=False):
            self._done, self._total = done, total
            self._write_line(seconds)

    def __enter__(self) -> CountedProgress:
        return self

    def __exit__(self, *error: Any) -> None:
        if self._width:
            self._clear_line()
            _line.release()
