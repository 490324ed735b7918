"""``python -m atlas`` runs the command ``atlas``, also where the shell does not find it."""

import sys


def main() -> None:
    """Run the command; Ctrl-C ends it in order while its imports are still on their way."""
    try:
        from atlas.cli.main import main as command

        command(prog_name="atlas")
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
