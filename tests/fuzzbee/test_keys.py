"""Keys from a pseudo terminal."""

import os
import pty
import termios

from fuzzbee.keys import Keys, terminal_keys


def test_letters_and_arrows():
    ours, theirs = pty.openpty()
    keys = Keys(theirs)
    termios.tcsetattr(theirs, termios.TCSANOW, _raw(theirs))
    assert keys.pressed() == []
    os.write(ours, b"qs\x1b[A\x1b[B\r\x1b")
    assert keys.pressed() == ["q", "s", "up", "down", "enter", "escape"]
    os.close(ours)
    assert keys.pressed() == []
    assert keys.pressed() == []  # the terminal is gone, and not asked any more
    os.close(theirs)


def test_without_a_terminal_there_are_none():
    with terminal_keys() as keys:
        assert keys.pressed() == []


def _raw(descriptor):
    mode = termios.tcgetattr(descriptor)
    mode[3] &= ~(termios.ICANON | termios.ECHO | termios.ISIG)
    mode[0] &= ~termios.ICRNL
    return mode
