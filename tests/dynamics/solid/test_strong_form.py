"""The collocated internal force against the divergence of the material's own stress."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

import palpate as pt

pytestmark = [
    pytest.mark.quick(material=["mooney-rivlin"], poisson=[0.45]),
    pytest.mark.each_kind(material=["mooney-rivlin", "ogden"]),
]

LENGTH = 0.02


@dataclass(frozen=True, kw_only=True)
class Coupled(pt.materials.Material):
    """A law of the tests, whose every second derivative by the invariants matters."""

    c: float

    def _check_parameters(self):
        assert self.c > 0

    @property
    def shear_modulus(self):
        return 4.0 * self.c

    @property
    def shear_bulk_modulus(self):
        return 8.0 / 3.0 * self.c + 2.0 * self.c + 60.0 * self.c

    @staticmethod
    def energy(I1, I2, J, c):
        x, y, z = I1 - 3.0, I2 - 3.0, J - 1.0
        return c[0] * (x + y + x * x + 0.7 * x * y + 0.4 * y * y + 0.9 * x * z + 0.6 * y * z + z * z - 6.0 * np.log(J))

    @staticmethod
    def first(I1, I2, J, c):
        x, y, z = I1 - 3.0, I2 - 3.0, J - 1.0
        return (
            c[0] * (1.0 + 2.0 * x + 0.7 * y + 0.9 * z),
            c[0] * (1.0 + 0.7 * x + 0.8 * y + 0.6 * z),
            c[0] * (0.9 * x + 0.6 * y + 2.0 * z - 6.0 / J),
        )

    @staticmethod
    def second(I1, I2, J, c):
        k = c[0]
        return 2.0 * k, 0.7 * k, 0.8 * k, 0.9 * k, 0.6 * k, k * (2.0 + 6.0 / (J * J))


LAWS = {
    "neo-hookean": pt.materials.NeoHookean(C1=20e3, density=1000, poisson=0.4),
    "mooney-rivlin": pt.materials.MooneyRivlin(C1=20e3, C2=15e3, density=1000, poisson=0.49),
    "coupled": Coupled(c=5e3, density=1000, bulk=200e3),
    "gent": pt.materials.Gent(mu=20e3, Jm=3.0, density=1000, poisson=0.4),
    "ogden": pt.materials.Ogden(C=(5e3, 300.0, 500.0), alpha=(1.3, 5.0, -2.0), density=1000, poisson=0.4),
    "logarithmic": pt.materials.Logarithmic(
        C1=20e3, C2=0.35, C3=3e3, alpha1=2.0, alpha2=1.5, density=1000, poisson=0.4
    ),
}


@pytest.fixture(params=LAWS)
def material(request):
    return LAWS[request.param]


@pytest.fixture(params=[0.0, 0.2], ids=["lattice", "jitter"])
def cloud(request):
    return pt.box((LENGTH,) * 3, spacing=LENGTH / 4, jitter=request.param)


class Quadratic:
    """A deformation x = F0 X + B X X / 2, whose gradient is linear."""

    def __init__(self, seed, amount=0.25):
        random = np.random.default_rng(seed)
        self.F0 = np.eye(3) + amount * random.uniform(-1, 1, (3, 3))
        B = amount / LENGTH * random.uniform(-1, 1, (3, 3, 3))
        self.B = (B + B.transpose(0, 2, 1)) / 2

    def displacement(self, X):
        return X @ self.F0.T + np.einsum("ijk,nj,nk->ni", self.B, X, X) / 2 - X

    def gradient(self, X):
        return self.F0 + np.einsum("ijk,nk->nij", self.B, X)


class LinearVolume(Quadratic):
    """One whose volume ratio J is linear, so that smoothing the pressure changes nothing."""

    def __init__(self, seed):
        super().__init__(seed)
        shear = np.zeros((3, 3, 3))  # triangular: J = det(F0) (1 + b X_0)
        for (i, j, k), value in {
            (0, 0, 0): 0.3,
            (0, 1, 2): 0.4,
            (0, 2, 2): -0.5,
            (0, 1, 1): 0.3,
            (1, 2, 2): 0.6,
        }.items():
            shear[i, j, k] = shear[i, k, j] = value / LENGTH
        self.B = np.einsum("ai,ijk->ajk", self.F0, shear)


def balance(model, deformation):
    """Div P - c/h P N at every node, by differences of the material's stress."""
    X, step = model.cloud.points, 1e-5 * LENGTH
    force = np.zeros_like(X)
    for a in range(3):
        ahead, behind = (model.material.stress(deformation.gradient(X + s * step * np.eye(3)[a])) for s in (1, -1))
        force += (ahead - behind)[:, :, a] / (2 * step)
    P = model.material.stress(deformation.gradient(X))
    return force - model.half_cell * np.einsum("nij,nj->ni", P, model.cloud.boundary_vectors())


@pytest.mark.parametrize("half_cell", [2.0, 3.0])
def test_the_shear_force_is_exact_for_linear_deformation_gradients(cloud, material, half_cell):
    material = replace(material, poisson=None, bulk=material.shear_bulk_modulus)  # without a pressure
    assert material.lame == 0
    model = pt.Solid(cloud, material, form="strong", stiffness_damping=0.0, half_cell=half_cell)
    deformation = Quadratic(seed=1)
    expected = balance(model, deformation)
    found = model.force(deformation.displacement(cloud.points))
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_the_force_is_exact_where_the_pressure_is_linear(cloud, material):
    model = pt.Solid(cloud, material, form="strong", stiffness_damping=0.0)
    deformation = LinearVolume(seed=1)
    expected = balance(model, deformation)
    found = model.force(deformation.displacement(cloud.points))
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_the_force_is_close_where_the_pressure_is_not_linear(cloud, material):
    model = pt.Solid(cloud, material, form="strong", stiffness_damping=0.0)
    deformation = Quadratic(seed=1, amount=0.05)
    expected = balance(model, deformation)
    found = model.force(deformation.displacement(cloud.points))
    assert np.linalg.norm(found - expected) < 0.05 * np.linalg.norm(expected)


def test_patch_test_a_uniform_deformation_leaves_only_the_tractions(cloud, material):
    model = pt.Solid(cloud, material, form="strong", stiffness_damping=0.0)
    F = np.eye(3) + np.array([[0.3, 0.2, -0.1], [0.0, -0.2, 0.1], [0.1, 0.0, 0.1]])
    P = material.stress(F)
    force = model.force(cloud.points @ (F - np.eye(3)).T)
    scale = np.abs(P).max() / cloud.spacing
    np.testing.assert_allclose(force, -model.half_cell * cloud.boundary_vectors() @ P.T, atol=1e-9 * scale)
    np.testing.assert_allclose(force[np.setdiff1d(np.arange(len(cloud)), cloud.face_nodes)], 0, atol=1e-9 * scale)


def test_a_rigid_rotation_gives_no_stress_and_no_force(cloud, material, rotation):
    model = pt.Solid(cloud, material, form="strong", stiffness_damping=0.0)
    u = cloud.points @ (rotation - np.eye(3)).T + (0.1, 0.2, 0.3)
    bulk = material.bulk_modulus
    np.testing.assert_allclose(model.stress(u), 0, atol=1e-10 * bulk)
    np.testing.assert_allclose(model.cauchy_stress(u), 0, atol=1e-10 * bulk)
    np.testing.assert_allclose(model.force(u), 0, atol=1e-10 * bulk / cloud.spacing)


def test_the_force_turns_with_the_frame(cloud, material, rotation):
    model = pt.Solid(cloud, material, form="strong", stiffness_damping=0.0)
    u = Quadratic(seed=1).displacement(cloud.points)
    force = model.force(u)
    turned = model.force((cloud.points + u) @ rotation.T - cloud.points)
    np.testing.assert_allclose(turned, force @ rotation.T, atol=1e-9 * np.abs(force).max())


def test_nodal_stresses_of_a_uniform_deformation_are_the_materials(cloud, material):
    model = pt.Solid(cloud, material, form="strong", stiffness_damping=0.0)
    F = np.eye(3) + np.array([[0.3, 0.2, -0.1], [0.0, -0.2, 0.1], [0.1, 0.0, 0.1]])
    u, P = cloud.points @ (F - np.eye(3)).T, material.stress(F)
    np.testing.assert_allclose(model.stress(u), np.broadcast_to(P, (len(cloud), 3, 3)), atol=1e-9 * np.abs(P).max())
    cauchy = P @ F.T / np.linalg.det(F)
    np.testing.assert_allclose(model.cauchy_stress(u)[7], cauchy, atol=1e-9 * np.abs(P).max())
    np.testing.assert_allclose(model.deformation_gradient(u)[7], F, atol=1e-12)


def test_the_force_of_a_mirrored_deformation_is_mirrored(material):
    cloud = pt.box((LENGTH,) * 3, spacing=LENGTH / 4)
    model = pt.Solid(cloud, material, form="strong", stiffness_damping=0.0)
    number = np.arange(len(cloud)).reshape(5, 5, 5)
    u = Quadratic(seed=1).displacement(cloud.points)
    force = model.force(u)
    for axis in range(3):
        image = np.flip(number, axis).ravel()
        sign = np.where(np.arange(3) == axis, -1, 1)
        np.testing.assert_allclose(model.force(u[image] * sign), force[image] * sign, atol=1e-9 * np.abs(force).max())


@pytest.mark.slow
@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45, 0.49])
@pytest.mark.parametrize("wave", ["P", "S"])
def test_plane_waves_travel_at_the_speeds_of_p_and_s_waves(poisson, wave):
    cloud = pt.box((0.04,) * 3, spacing=0.005)
    material = pt.materials.MooneyRivlin(C1=40e3, C2=0, density=1000, poisson=poisson)
    model = pt.Solid(cloud, material, form="strong", stiffness_damping=0.0)
    mu, bulk = material.shear_modulus, material.bulk_modulus
    speed = np.sqrt(((bulk + 4 / 3 * mu) if wave == "P" else mu) / 1000)
    along = np.array([2.0, 1.0, 2.0]) / 3
    across = np.cross(along, (0, 0, 1)) / np.linalg.norm(np.cross(along, (0, 0, 1)))
    polarised = along if wave == "P" else across
    middle = int(np.argmin(np.linalg.norm(cloud.points - 0.02, axis=1)))
    errors = []
    for wavelength in (0.08, 0.16):  # 16 and 32 nodes
        number = 2 * np.pi / wavelength
        u = 1e-9 * np.cos(number * (cloud.points - 0.02) @ along)[:, None] * polarised
        frequency = np.sqrt(-model.force(u)[middle] @ polarised / (1000 * 1e-9))
        errors.append(abs(frequency / number / speed - 1))
    assert errors[0] < 0.04
    assert errors[1] < errors[0] / 3.5  # second order


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"half_cell": 0.5}, r"half_cell must be in \[1, 4\], got 0.5"),
        ({"neighbours": 9}, "neighbours must be .*, got 9"),
        ({"smoothing": 4}, "smoothing must be .*, got 4"),
        ({"stiffness_damping": -1e-5}, "stiffness_damping must be .*, got -1e-05"),
        ({"stiffness_damping": np.nan}, "stiffness_damping must be .*, got nan"),
        ({"fixed": "left"}, "group must be one of .*, got 'left'"),
        ({"fixed": ("x-", "left")}, "group must be one of .*, got 'left'"),
    ],
)
def test_a_model_refuses_arguments_by_name(small_cloud, tissue, arguments, message):
    with pytest.raises(pt.InputError, match=message):
        pt.Solid(small_cloud, tissue, form="strong", **arguments)


def test_a_model_needs_a_cloud_in_space(tissue):
    with pytest.raises(pt.InputError, match="plane"):
        pt.Solid(pt.box((1.0, 1.0), 0.1), tissue, form="strong")
