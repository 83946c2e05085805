"""``python -m lidarsim``: the command line."""

from lidarsim.cli import main

if __name__ == "__main__":
    main()
