"""MAVLink: frames, messages, and the link that carries them."""
