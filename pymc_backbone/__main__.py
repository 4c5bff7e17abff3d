"""``python -m pymc_backbone`` is ``pymc-backbone``."""

from .cli.main import run

if __name__ == "__main__":
    run()
