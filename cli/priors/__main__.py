"""`python -m cli.priors build ...`: the program without its installed command."""

from cli.priors import main

if __name__ == "__main__":
    main()
