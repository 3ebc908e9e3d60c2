"""The live service as several processes; see docs/fleets.md and docs/design.md."""
