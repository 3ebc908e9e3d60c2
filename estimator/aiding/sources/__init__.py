"""What each source says about the aiding's errors: velocity, the magnetic field, gravity."""
