"""Fixtures that the overlay's tests share with the others."""

from tests.conftest import shared_data as shared_data
