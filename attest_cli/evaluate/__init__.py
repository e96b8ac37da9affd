"""A track against a reference: attitude (BROAD's definitions), position (as evo), NEES, coverage, time offset."""

from . import claims
from .judge import evaluate
from .records import Claims, Evaluation, Options, Poses

__all__ = ["Claims", "Evaluation", "Options", "Poses", "claims", "evaluate"]
