"""Room for senders by the memory that there is."""

import pytest

from drivers import resources

GIB = 1 << 30


@pytest.mark.parametrize("version", [0, 1])
@pytest.mark.parametrize(
    ("machine", "limit", "expected"),
    [
        (16 * GIB, None, 4096),
        (16 * GIB, "max", 4096),
        (16 * GIB, 3 * GIB, 1536),  # a container that may have less
        (16 * GIB, 256 << 20, 512),
        (2 * GIB, 3 * GIB, 1024),
        (None, None, 512),
    ],
)
def test_there_is_room_for_as_many_as_machine_and_container_have(
    machine, limit, expected, version, tmp_path, monkeypatch
):
    def sysconf(name):
        if machine is None:
            raise ValueError(name)
        return {"SC_PHYS_PAGES": machine // 4096, "SC_PAGE_SIZE": 4096}[name]

    monkeypatch.setattr(resources.os, "sysconf", sysconf)
    files = tmp_path / "memory.max", tmp_path / "limit_in_bytes"
    monkeypatch.setattr(resources, "GROUP", files)
    if limit is not None:
        files[version].write_text(f"{limit}\n")
    assert resources.slots() == expected
