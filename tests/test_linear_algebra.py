"""Mixtures of normal distributions."""

import numpy as np

from bodylog.linear_algebra import mix_normals


def test_a_mixture_has_the_moments_of_its_draws() -> None:
    draw = np.random.default_rng(3)
    shares = np.array([[0.2, 0.8], [0.5, 0.5]])
    means = draw.normal(size=(2, 2, 3))
    roots = draw.normal(size=(2, 2, 3, 3))
    mean, cov = mix_normals(shares, means, roots @ roots.swapaxes(-1, -2))
    count = 200_000
    for k in range(2):
        which = draw.choice(2, size=count, p=shares[k])
        drawn = means[k, which]
        drawn += np.einsum("nab,nb->na", roots[k, which], draw.normal(size=(count, 3)))
        scale = np.sqrt(np.diag(cov[k]))
        assert (np.abs(drawn.mean(axis=0) - mean[k]) < 5.0 * scale / count**0.5).all()
        assert np.abs((np.cov(drawn.T) - cov[k]) / np.outer(scale, scale)).max() < 0.03
