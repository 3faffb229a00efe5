"""Patterns: what a projector shows, and which beams it lights with them."""

from tankrig.pattern.pattern import Pattern

__all__ = ["Pattern"]
