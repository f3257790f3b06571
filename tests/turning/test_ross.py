"""Against ROSS itself: the same matrix entered by hand, the full one assembled by hand, and a transient with K(φ)."""

import inspect

import numpy as np
import pytest
from scipy import linalg

import difftrb as trb
from difftrb.core.geometry import cage_rate
from difftrb.turning.cage_turn import CageTurn

rs = pytest.importorskip("ross", exc_type=ImportError) if __import__("importlib.util").util.find_spec("ross") else None
if rs is None:
    pytest.skip("ROSS is not installed", allow_module_level=True)
pytestmark = pytest.mark.filterwarnings("default")
SPEED = 300.0


@pytest.fixture(scope="module")
def turn() -> CageTurn:
    return trb.stiffness(trb.Scene("32008J", trb.Load(9000.0, 4500.0), (trb.Spall(4.0, 7.0),)), 64).check()


def rotor(elements: list) -> rs.Rotor:
    steel = rs.Material("steel", rho=7810, E=211e9, G_s=81.2e9)
    shaft = [rs.ShaftElement(L=0.05, idl=0.0, odl=0.04, material=steel) for _ in range(6)]
    disk = rs.DiskElement.from_geometry(n=3, material=steel, width=0.05, i_d=0.04, o_d=0.2)
    return rs.Rotor(shaft, [disk], elements)


def natural(one: rs.Rotor) -> np.ndarray:
    return one.run_modal(speed=SPEED, num_modes=24, sparse=False).wn[:8]


def test_axes_and_signs(turn: CageTurn) -> None:
    """Load along −y: ROSS's y is radial, x lateral, z axial; the load pulls the shaft to −y and to z."""
    K, own = np.asarray(turn.mean_stiffness), trb.ross.stiffness_in_metres(turn)
    np.testing.assert_allclose([own[1, 1], own[0, 0], own[2, 2]], 1e3 * np.diag(K), rtol=1e-12)
    assert own[1, 2] == pytest.approx(-1e3 * K[0, 2], rel=1e-9)
    along_x = trb.ross.stiffness_in_metres(turn, load_angle=0.0, axial=-1)
    assert along_x[0, 2] == pytest.approx(-1e3 * K[0, 2], rel=1e-9)
    with pytest.raises(trb.SceneError, match="axial = 2"):
        trb.ross.axes(0.0, 2)  # type: ignore[arg-type]


def test_same_matrix_by_hand_gives_the_same_frequencies(turn: CageTurn) -> None:
    ours = rotor([trb.ross.bearing_element(turn, n, cxx=1e3, coupled=False) for n in (0, 6)])
    K = 1e3 * np.asarray(turn.mean_stiffness)
    by_hand = {"kxx": K[1, 1], "kyy": K[0, 0], "kxy": -K[0, 1], "kyx": -K[1, 0], "kzz": K[2, 2], "cxx": 1e3}
    hand = rotor([rs.BearingElement(n=n, **{k: float(v) for k, v in by_hand.items()}) for n in (0, 6)])
    np.testing.assert_allclose(natural(ours), natural(hand), rtol=1e-9)


def test_the_coupled_element_is_in_the_assembled_matrix(turn: CageTurn) -> None:
    """Against ROSS's matrices with the missing terms added by hand."""
    plain, full = (rotor([trb.ross.bearing_element(turn, n, coupled=c) for n in (0, 6)]) for c in (False, True))
    K, own = plain.K(0.0).copy(), trb.ross.stiffness_in_metres(turn)
    for n in (0, 6):
        at = plain.number_dof * n + np.arange(3)
        K[np.ix_(at[:2], at[2:])] += own[:2, 2:]
        K[np.ix_(at[2:], at[:2])] += own[2:, :2]
    np.testing.assert_allclose(full.K(0.0), K, rtol=1e-12, atol=1e-3)
    assert not np.allclose(full.K(0.0), plain.K(0.0))


def test_healthy_and_spalled_bearings_differ(turn: CageTurn) -> None:
    sound = trb.stiffness(trb.Scene("32008J", trb.Load(9000.0, 4500.0)), 16)
    spalled, healthy = (natural(rotor([trb.ross.bearing_element(each, n) for n in (0, 6)])) for each in (turn, sound))
    assert (spalled <= healthy * (1.0 + 1e-9)).all()
    assert spalled[0] < healthy[0] * (1.0 - 1e-5)


def transients(turn: CageTurn, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Of the bearing's node [m], shape (steps, 3): by our force beside the mean stiffness, and by a stiffness matrix
    that is renewed at every step of ROSS's Newmark method, as ROSS does for gear meshes."""
    one = rotor([trb.ross.bearing_element(turn, n, cxx=2e4) for n in (0, 6)])
    t = np.linspace(0.0, 0.004, steps + 1)
    force = trb.ross.passage_force(turn, one, 0, SPEED, t)
    still = np.zeros((t.size, one.ndof))
    ours = one.run_time_response(SPEED, still, t, method="newmark", add_to_RHS=force).yout

    across, at = trb.ross.axes(), np.arange(3)
    place = t * float(cage_rate(turn.bearing, SPEED * 30.0 / np.pi)) / float(turn.span) * 64

    def between(values: np.ndarray, step: int) -> np.ndarray:
        low = int(place[step])
        share = place[step] - low
        return (1.0 - share) * values[low % 64] + share * values[(low + 1) % 64]

    stiff, moved = np.asarray(turn.stiffness), np.asarray(turn.waveform)
    mean = stiff.mean(axis=0)
    M, C, mean_K = one.M(), one.C(SPEED) + one.G() * SPEED, one.K(SPEED)

    def system(step: int, **_: object) -> tuple:
        K, f = mean_K.copy(), np.zeros(one.ndof)
        now = 1e3 * across @ between(stiff, step) @ across.T
        K[np.ix_(at, at)] += now - 1e3 * across @ mean @ across.T
        f[:3] = now @ (across @ between(moved, step)) * 1e-3
        return M, C, K, f

    more = (lambda step, **_: system(step)[3],) if "rhs_func" in inspect.signature(rs.utils.newmark).parameters else ()
    return ours[:, :3], rs.utils.newmark(system, *more, t, one.ndof)[:, :3]  # more: from ROSS 3 on


def test_the_passage_is_that_of_a_matrix_that_changes(turn: CageTurn) -> None:
    """Both transients solve M q̈ + C q̇ + K(φ) q = K(φ) (u(φ) − ū). ROSS gives its right-hand side the place of the
    step before, so they differ by what one step is long: half as much with half of it."""
    errors = []
    for steps in (200, 400):
        ours, theirs = transients(turn, steps)
        size = np.abs(theirs).max()
        assert size > 1e-9
        errors.append(np.abs(ours - theirs).max() / size)
    assert errors[0] < 1e-2
    assert errors[1] < 0.7 * errors[0]


def test_stands_still_where_the_ring_rests(turn: CageTurn) -> None:
    """At creeping speed the passage force moves a shaft on this bearing alone by the waveform: K q = f."""
    one = rotor([trb.ross.bearing_element(turn, 0), trb.ross.bearing_element(turn, 6)])
    times = np.asarray(turn.time(SPEED * 30.0 / np.pi))
    force = trb.ross.passage_force(turn, one, 0, SPEED, times)
    own, waveform = trb.ross.axes() @ np.asarray(turn.waveform).T * 1e-3, []
    for step in (3, 17):
        q = np.zeros(one.ndof)
        q[:3] = own[:, step]
        stiff = 1e3 * trb.ross.axes() @ np.asarray(turn.mean_stiffness) @ trb.ross.axes().T
        waveform.append(linalg.solve(stiff, force(step, disp_resp=q)[:3]))
    np.testing.assert_allclose(np.transpose(waveform), own[:, [3, 17]], rtol=1e-6, atol=1e-15)


def test_a_secant_is_refused() -> None:
    scene = trb.Scene("32008J", trb.Load(9000.0, 4500.0), law="liu2018", definition="secant")
    with pytest.raises(trb.SceneError, match="a rotor needs the tangent"):
        trb.ross.bearing_element(trb.solve(scene), 0)
