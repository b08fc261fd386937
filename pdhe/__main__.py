"""Run the command line with ``python -m pdhe``."""

import sys

from pdhe.warm import main

sys.exit(main(sys.argv[1:]))
