"""`python -m radiosity` is the program `radiosity`."""

from ._command_line import main

main()
