"""The program `radiosity`."""

import sys

from ._radiosity import command_line


def main() -> None:
    """Run the command-line program with the arguments of this process."""
    sys.exit(command_line(["radiosity", *sys.argv[1:]]))


if __name__ == "__main__":
    main()
