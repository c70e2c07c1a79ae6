"""`python -m zoo` is `zoo`."""

from zoo.cli import app

if __name__ == "__main__":
    app()
