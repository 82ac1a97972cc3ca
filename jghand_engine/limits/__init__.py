"""Every numerical constant of the engine: value, unit, why, and what breaks when it changes.

One module per room; all of them are read as `from jghand_engine.limits import NAME`. The kernels receive these values
as arguments or repeat them in `native/constants.h`, which a test compares with these.
"""

from jghand_engine.limits.avatar import *
from jghand_engine.limits.service import *
from jghand_engine.limits.splat import *
