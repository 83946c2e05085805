"""Scan patterns: which pulses a frame fires, in the sensor frame."""

from __future__ import annotations

from lidarsim.patterns._pulses import Pattern, Pulses
from lidarsim.patterns.spinning import Spinning

__all__ = ["Pattern", "Pulses", "Spinning"]
