"""Recompute the figures of Cheng and Xu (2007) and check each of its claims."""

from .run import paper

__all__ = ["paper"]
