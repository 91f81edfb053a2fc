"""`python -m codecbench` is `codecbench`."""

from codecbench.cli import main

main()
