"""The first attitude, from the first vectors."""

import numpy as np

from estimator.filter.types import Vectors
from estimator.geometry.quaternion import normalize, shortest_rotation
from estimator.types import Floats, Quaternion


def nearest_rotation(matrix: Floats) -> Floats:
    """The rotation matrix closest to a (3, 3) matrix in the Frobenius norm, by SVD.

    Source: F. L. Markley, "Attitude determination using vector observations and the singular value
    decomposition", J. Astronautical Sciences 36(3), 1988.
    """
    U, _, Vt = np.linalg.svd(matrix)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U) * np.linalg.det(Vt)]) @ Vt)


def quaternion_from_matrix(R: Floats) -> Quaternion:
    """Unit quaternion of a (3, 3) rotation matrix, w >= 0.

    It divides by the largest of the four components, which the diagonal shows.
    """
    t = np.trace(R)
    squares = np.array([t, *(2.0 * np.diag(R) - t)])  # 4 q_i^2 - 1
    i = int(np.argmax(squares))
    q = np.empty(4)
    if i == 0:
        q[:] = (1.0 + t, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
    else:
        j, k, m = i - 1, i % 3, (i + 1) % 3  # matrix indices of this axis and the next two
        q[0] = R[m, k] - R[k, m]
        q[1 + j] = 1.0 + squares[i]
        q[1 + k] = R[k, j] + R[j, k]
        q[1 + m] = R[m, j] + R[j, m]
    q *= np.copysign(1.0, q[0])
    w, x, y, z = (float(c) for c in q)
    return normalize((w, x, y, z))


def align(vectors: Vectors) -> Quaternion:
    """``q_ned_frd`` that fits the vectors best (Wahba's problem, by SVD).

    Without the magnetic vector it is the smallest turn that levels gravity: the heading is unknown.
    """
    if vectors.s1 <= 0.0 or vectors.s2 <= 0.0:
        if vectors.s2 > 0.0:
            return shortest_rotation(vectors.v2_frd, vectors.v2_ned)
        return shortest_rotation(vectors.v1_frd, vectors.v1_ned)
    B = vectors.s1 * np.outer(vectors.v1_ned, vectors.v1_frd)
    B += vectors.s2 * np.outer(vectors.v2_ned, vectors.v2_frd)
    return quaternion_from_matrix(nearest_rotation(B))
