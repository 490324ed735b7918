"""Entry point of ``python -m atlas``: the command ``atlas``, also where the shell does not find the command."""

import sys


def main() -> None:
    """Run the command; Ctrl-C exits with code 130 even while its imports are being loaded."""
    try:
        from atlas.cli.main import main as command

        command(prog_name="atlas")
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
