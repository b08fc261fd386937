"""Run the command line with ``python -m pdhe``."""

import os
import sys

if os.environ.get("PDHE_WARM"):
    from pdhe.warm import main
else:
    from pdhe.cli import main

sys.exit(main(sys.argv[1:]))
