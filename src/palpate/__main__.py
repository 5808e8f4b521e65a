"""``python -m palpate`` is the command ``palpate``."""

from palpate.app.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
