"""``python -m atlas`` runs the command ``atlas``, also where the shell does not find it."""

from atlas.cli.main import main

if __name__ == "__main__":
    main(prog_name="atlas")
