"""A frame as one bundle of the protocol: ``OK``, ``T``, ``Root/Pos`` and every ``Bone/Pos``."""

from __future__ import annotations

import numpy as np

from .humanoid import Humanoid
from .osc import encode_bundle, encode_message

OK, TIME, ROOT, BONE = "/VMC/Ext/OK", "/VMC/Ext/T", "/VMC/Ext/Root/Pos", "/VMC/Ext/Bone/Pos"
_UNTURNED = (0.0, 0.0, 0.0, 1.0)
_XYZW = [1, 2, 3, 0]
"""Columns of a quaternion w x y z in VMC's order."""


class FrameBundle:
    """Makes the bundles of a humanoid: all but the numbers is laid out once.

    The root stands at the world's origin and does not turn; the hips have the path. Bones have their places in the
    T-pose relative to their parents.
    """

    def __init__(self, humanoid: Humanoid) -> None:
        """Lay the bundle out.

        Raises:
            MotionInvalid: the body is no humanoid.
        """
        self.humanoid = humanoid
        numbers = np.concatenate([humanoid.offsets, np.tile(_UNTURNED, (len(humanoid.bones), 1))], axis=1)
        bones = [
            encode_message(BONE, [name, *values]) for name, values in zip(humanoid.bones, numbers.tolist(), strict=True)
        ]
        root = encode_message(ROOT, ["root", 0.0, 0.0, 0.0, *_UNTURNED])
        elements = [encode_message(OK, [1]), encode_message(TIME, [0.0]), root, *bones]
        self._bytes = np.frombuffer(encode_bundle(elements), np.uint8).copy()
        # Each element's numbers are its last bytes; each element has its size before it.
        ends = 16 + np.cumsum([4 + len(element) for element in elements])
        self._time = slice(ends[1] - 4, ends[1])
        self._hips = slice(ends[3] - 28, ends[3] - 16)
        self._turns = (ends[3:, None] - 16 + np.arange(16)).ravel()

    def encode(self, time_s: float, rotvec: np.ndarray, transl: np.ndarray) -> bytes:
        """Return the bundle of a pose.

        Args:
            time_s: seconds on the sender's clock.
            rotvec: (n, 3) axis-angles of the first n joints.
            transl: (3,) metres, see ``Humanoid.to_unity``.
        """
        quat, hips = self.humanoid.to_unity(rotvec, transl)
        self._bytes[self._time] = _big_endian(np.array([time_s]))
        self._bytes[self._hips] = _big_endian(hips)
        self._bytes[self._turns] = _big_endian(quat[:, _XYZW])
        return self._bytes.tobytes()


def _big_endian(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, ">f4").reshape(-1).view(np.uint8)
