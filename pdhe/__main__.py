"""Run the command line with ``python -m pdhe``."""

import sys

from pdhe.cli import main

sys.exit(main())
