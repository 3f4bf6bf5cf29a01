"""`python -m map_service`, and the entry point of `map-service`.

Every process that the service starts imports this file again: what the command needs is imported when it runs.
"""

from __future__ import annotations


def main() -> None:
    """The command; exit code 2 and one line on stderr for whatever the user can mend."""
    from map_service import command

    command.main()


if __name__ == "__main__":
    main()
