"""``python -m atlas`` is the command ``atlas``, where that is not on the path."""

from atlas.cli.main import main

if __name__ == "__main__":
    main(prog_name="atlas")
