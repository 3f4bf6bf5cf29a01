"""`python -m splitslam.cli`: the same as `splitslam`."""

from splitslam.cli import main

if __name__ == "__main__":
    main()
