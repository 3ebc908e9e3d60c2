"""How kernels are compiled and kept: the only room of the estimator that touches a disk."""
