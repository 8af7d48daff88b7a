"""``python -m gyro_calib.cli``."""

import sys

from .main import main

sys.exit(main())
