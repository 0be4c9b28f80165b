"""The paper of Cheng and Xu (2007), recomputed: its figures, and each of its claims beside what is true."""

from .run import paper

__all__ = ["paper"]
