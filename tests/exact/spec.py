"""A shape by its arguments, so that one case serves lidarsim, the oracle and the textbook alike."""

from __future__ import annotations

from operator import attrgetter

import numpy as np
import numpy.typing as npt
from exact import oracle, textbook

from lidarsim.bench import scenes

Floats = npt.NDArray[np.float64]


class Spec(scenes.Spec):
    """A shape by the name of its class or constructor, its arguments and its transform."""

    def judge(self) -> oracle.Shape:
        """Return the oracle's shape."""
        shape: oracle.Shape = attrgetter(self.kind)(oracle)(*self.args)
        return shape if self.transform is None else oracle.Transformed(shape, self.transform)

    def textbook(self, origins: Floats, directions: Floats) -> Floats | None:
        """Return the textbook's roots, (n, k), or None where the textbook has no such shape."""
        formula = textbook.FORMULAS.get(self.kind)
        if self.transform is not None:
            inverse = np.linalg.inv(self.transform)
            origins, directions = origins @ inverse[:3, :3].T + inverse[:3, 3], directions @ inverse[:3, :3].T
        return None if formula is None else formula(origins, directions, *self.args)
