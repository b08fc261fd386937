"""Slow twins of kernels, in NumPy, for any number of dimensions."""

import numpy as np


def correspondence_twin(x, body, u, law):
    """Gradients, energies, forces and loads of an elasticity tensor, term by term from theory eqs. 2.14 to 2.21."""
    b, owner, (n, d) = body.bonds, body.bonds.owners(), x.shape
    xi, eta = x[b.neighbours] - x[owner], u[b.neighbours] - u[owner]
    over_r = np.where(body.intact, b.weight, 0.0) / b.length
    gradient, inverse, control = (np.zeros((n, d, d)) for _ in range(3))
    share = np.ones(n)
    for i in range(n):
        mine = owner == i
        shape = np.einsum("k,ka,kb->ab", over_r[mine], xi[mine], xi[mine]) / body.volume[i]
        inverse[i] = np.linalg.inv(shape)
        whole = np.einsum("k,ka,kb->ab", (b.weight / b.length)[mine], xi[mine], xi[mine]) / body.volume[i]
        share[i] = min(1.0, np.linalg.eigvalsh(shape)[0] / (0.25 * np.linalg.eigvalsh(whole)[0]))
        gradient[i] = np.einsum("k,ka,kb->ab", over_r[mine], eta[mine], xi[mine]) / body.volume[i] @ inverse[i]
        control[i] = np.einsum("acbd,bd->ac", law, inverse[i])
        if body.model.zero_energy == "silling":
            control[i] = 0.5 * body.normal * np.eye(d)
        values, vectors = np.linalg.eigh(control[i])
        control[i] = share[i] * body.model.zero_energy_strength * vectors @ np.diag(np.maximum(values, 0.0)) @ vectors.T
    stress = share[:, None, None] * np.einsum("acbd,nbd->nac", law, gradient)
    z = eta - np.einsum("kab,kb->ka", gradient[owner], xi)
    # Force states over the weight; the energy of a bond is defined for broken ones as well.
    state = np.einsum("kab,kb->ka", (stress @ inverse)[owner], xi) + np.einsum("kab,kb->ka", control[owner], z)
    state /= b.length[:, None]
    force = np.zeros((n, d))
    np.add.at(force, owner, (over_r * b.length)[:, None] * (state - state[b.reverse]))
    energy = 0.5 * body.volume * np.einsum("nab,nab->n", stress, gradient)
    np.add.at(energy, owner, 0.5 * over_r * np.einsum("ka,kab,kb->k", z, control[owner], z))
    turned = eta - np.einsum("kab,kb->ka", 0.5 * (gradient - gradient.transpose(0, 2, 1))[owner], xi)
    work = np.sum(state * turned, axis=1)
    square = (work + work[b.reverse]) / b.length / body.normal
    stretch = np.sum(xi * eta, axis=1) / b.length**2
    return gradient, energy, force, np.where(stretch > 0.0, np.sqrt(np.maximum(square, 0.0)), 0.0)
