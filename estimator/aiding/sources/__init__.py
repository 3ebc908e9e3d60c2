"""What each source shows about the aiding's errors: velocity, the magnetic field, gravity."""
