"""``python -m pymc_backbone`` is ``pymc-backbone``."""

import sys

from .cli.main import main

if __name__ == "__main__":
    sys.exit(main())
