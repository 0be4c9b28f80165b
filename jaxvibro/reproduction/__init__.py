"""Recompute the figures of Cheng and Xu (2007) and check each claim of the paper."""

from .run import paper

__all__ = ["paper"]
