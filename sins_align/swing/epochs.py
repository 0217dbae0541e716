"""The stored increments of an alignment, one epoch a row, in b0 axes."""

from __future__ import annotations

import math

import numpy as np

from sins_align.rotation import dcm_from_quaternion, multiply_quaternions, rotations_about
from sins_align.types import Array
from sins_align.windows import Windows

# What of the motion so far stands for what is to come.
WINDOW_S = 60.0


class Epochs:
    """Epoch k runs from node k to node k + 1; node 0 is the first sample.

    duration_s : (K,); time_s : (K+1,) of the nodes from the first sample on
    C : (K+1, 3, 3) rotation b -> b0 at the nodes, by the raw gyros alone
    u, s : (K, 3) int C f, int int C f over the epoch [m/s], [m]
    B, BB : (K, 3, 3) int C, int int C over the epoch [s], [s^2]
    """

    def __init__(self) -> None:
        self._size = 0
        self._q = np.array([1.0, 0.0, 0.0, 0.0])
        self._arrays: dict[str, Array] = {
            "duration_s": np.empty(64),
            "time_s": np.zeros(65),
            "C": np.broadcast_to(np.eye(3), (65, 3, 3)).copy(),
            "u": np.empty((64, 3)),
            "s": np.empty((64, 3)),
            "B": np.empty((64, 3, 3)),
            "BB": np.empty((64, 3, 3)),
        }

    def __len__(self) -> int:
        return self._size

    def __getattr__(self, name: str) -> Array:
        if name.startswith("_") or name not in self._arrays:
            raise AttributeError(name)
        nodes = name in ("time_s", "C")
        return self._arrays[name][: self._size + nodes]

    @property
    def q(self) -> Array:
        """(4,) rotation b -> b0 at the last node."""
        return self._q

    def continued(self, count: int, w_ie_b0: Array) -> Epochs:
        """These epochs and `count` more, of a base that goes on moving as it did.

        The last ones come again and again, from where the attitude was most nearly the last one;
        meanwhile the base turns with the Earth at w_ie_b0 (3,) [rad/s].
        """
        again = np.arange(self._most_alike(), self._size)
        index = np.resize(again, count)
        duration = self.duration_s[index]
        end_s = self.time_s[-1] + np.cumsum(duration)
        E = rotations_about(w_ie_b0, end_s - self.time_s[index + 1])
        new = {
            "duration_s": duration,
            "time_s": end_s,
            "C": E @ self.C[index + 1],
            "u": np.einsum("kij,kj->ki", E, self.u[index]),
            "s": np.einsum("kij,kj->ki", E, self.s[index]),
            "B": E @ self.B[index],
            "BB": E @ self.BB[index],
        }
        other = Epochs()
        other._size, other._q = self._size + count, self._q
        other._arrays = {k: np.concatenate((getattr(self, k), v)) for k, v in new.items()}
        return other

    def _most_alike(self) -> int:
        """The node of the last minute, but for the last third of it, most like the last one."""
        length = round(WINDOW_S / float(self.duration_s.mean()))
        first, end = max(self._size - length, 0), max(self._size - length // 3, 1)
        off = self.C[first:end] - self.C[-1]
        return first + int(np.argmin(np.einsum("kij,kij->k", off, off)))

    def append(self, windows: Windows) -> None:
        """Add the windows of a block that begins at the last node."""
        count = windows.duration_s.shape[0]
        while self._size + count >= self._arrays["u"].shape[0]:
            self._arrays = {
                name: np.concatenate((a, np.empty_like(a))) for name, a in self._arrays.items()
            }
        old, new = self._size, self._size + count
        a = self._arrays
        C0 = dcm_from_quaternion(self._q)
        a["duration_s"][old:new] = windows.duration_s
        a["time_s"][old + 1 : new + 1] = a["time_s"][old] + np.cumsum(windows.duration_s)
        a["u"][old:new] = windows.u @ C0.T
        a["s"][old:new] = windows.s @ C0.T
        a["B"][old:new] = C0 @ windows.B
        a["BB"][old:new] = C0 @ windows.BB
        a["C"][old + 1 : new + 1] = C0 @ windows.C_end
        q = multiply_quaternions(self._q, windows.q_end)
        self._q = q / math.sqrt(float(q @ q))
        self._size = new
