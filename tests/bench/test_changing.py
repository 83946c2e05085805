"""Scenes that change: each call sees the scene as it is in its frame."""

from __future__ import annotations

import math

import pytest

from lidarsim.bench import changing, peers

SIDE = 101


def test_each_call_sees_the_change_of_its_frame() -> None:
    what = changing.calls(peers.find_installed()[0], 1, SIDE)
    assert {"1,000 instances moved", "20,000 faces refitted", "20,000 faces built anew"} <= {*what}
    for frame in range(3):
        phase = changing.STEP * frame
        for name, (_, call) in what.items():
            if "motions" in name:
                continue
            # The ray meets the top of a ball, or a sheet with edges of 0.1 m in place of the wave.
            is_ball, top = "instances" in name, 0.3 * math.sin(0.3 + phase)
            expected = changing.HEIGHT - (phase if is_ball else top)
            assert call() == pytest.approx(expected, abs=1e-5 + (0.0 if is_ball else 0.3 * 0.1**2 / 8)), name


def test_instances_with_motions_move() -> None:
    call = changing.calls((), 1, 3)["1,000 instances with motions"][1]
    assert len({call() for _ in range(3)}) == 3
