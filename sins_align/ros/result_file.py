"""A node's result file: what goes in, and what is left standing at the end."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from sins_align.ros.result import Timing, result_document, write_result
from sins_align.ros.whole_file import remove_leftovers
from sins_align.session import Session


class ResultFile:
    """Writes a session's result, whole or not at all, and knows what it has written.

    The file says how it stands now: `aligned` is true in it only while the session is aligned.
    With one exception: an alignment that was complete, of this run or the one that this run
    went on from, is not thrown away at the end of the process for the beginnings of another one.

    Parameters
    ----------
    node : `swing_align` or `odo_align`
    path : where it goes; '': nowhere
    initial : the file that this run went on from; '': none

    estimate_s : wall time spent on the estimation so far [s]; the node's to count
    """

    def __init__(self, node: str, path: str, initial: str = "") -> None:
        self.path = ""
        self.estimate_s = 0.0
        self._node = node
        self._begun = time.monotonic()
        # Beginnings before the alignment whose complete result stands in the file.
        self._complete: int | None = None
        # Where the alignment stands that this run went on from; '': nowhere any more.
        self._initial = os.path.realpath(initial) if initial else ""
        self.set_path(path)

    def set_path(self, path: str) -> None:
        """Write there from now on; '': nowhere. That it can be written is known."""
        if path:
            remove_leftovers(Path(path))
        if path != self.path:
            self.path, self._complete = path, None

    def write(self, session: Session) -> None:
        """Write the result as it is now. Nothing where there is no path.

        Raises
        ------
        OSError : it could not be written; names the path, and the old file is still there
        """
        if self.path:
            self._put(self._document(session), session.beginnings)

    def write_last(self, session: Session) -> bool:
        """As `write`, unless what stands in the file is better.

        It is, when it is of a complete alignment and the alignment has begun anew since, or
        when there is no attitude now; and when this run went on from it and is not aligned.

        Returns
        -------
        False where the file was left as it is

        Raises
        ------
        OSError : as `write`
        """
        if not self.path:
            return True
        document = self._document(session)
        if not document["aligned"] and Path(self.path).exists():
            if os.path.realpath(self.path) == self._initial:
                return False
            begun_anew = session.beginnings != self._complete
            if self._complete is not None and (begun_anew or document["q_nb_wxyz"] is None):
                return False
        self._put(document, session.beginnings)
        return True

    def _put(self, document: dict[str, Any], beginnings: int) -> None:
        write_result(Path(self.path), document)
        self._complete = beginnings if document["aligned"] else None
        if os.path.realpath(self.path) == self._initial:
            self._initial = ""

    def _document(self, session: Session) -> dict[str, Any]:
        timing = Timing(time.monotonic() - self._begun, 0.0, self.estimate_s)
        return result_document(self._node, session, session.conclusion, timing)
