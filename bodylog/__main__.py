"""python -m bodylog: the command line."""

from runpy import run_module

if __name__ == "__main__":
    run_module("bodylog_cli", run_name="__main__")
