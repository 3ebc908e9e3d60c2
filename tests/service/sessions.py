"""Zenoh sessions for the tests."""

from service.zenoh_session import OpeningSession


def open_session(options):
    """An open session; whoever opened it closes it."""
    return OpeningSession(options).session()
