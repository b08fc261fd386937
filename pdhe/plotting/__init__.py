"""Results turned into pictures: figures at chosen times, animations, curves over time.

Figures are objects drawn with Agg, so that nothing depends on a display or on what was drawn before.
"""

from pdhe.plotting.animation import animate
from pdhe.plotting.figure import draw
from pdhe.plotting.history import draw_history

__all__ = ["animate", "draw", "draw_history"]
