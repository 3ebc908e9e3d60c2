"""The live service: pipeline, loop, sinks and Zenoh."""
