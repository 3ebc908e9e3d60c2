"""The light display: one page for any browser, which needs no other file and no network."""
