"""The part of the extension that knows no Blender also runs in Blender's Python: the same tests once more."""

from test_batch import *  # noqa: F403
from test_controls_numbers import *  # noqa: F403
from test_film import *  # noqa: F403
from test_motions_without_engine import *  # noqa: F403
from test_poses import *  # noqa: F403
from test_posing import *  # noqa: F403
from test_stamp import *  # noqa: F403
