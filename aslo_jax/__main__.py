"""`python -m aslo_jax`: the command line."""

from .cli import main

main()
