"""A contact with a closed form, to stand in for the solver: then only interpolation is at work."""

import jax
import jax.numpy as jnp
import numpy as np

from difftrb.contact import crown
from difftrb.core import status
from difftrb.law import samples


def half_width(contact, load):
    return jnp.sqrt(4.0 * load * contact.radius / (jnp.pi * contact.modulus * contact.length))


def healthy(contact, delta):
    """Load on a healthy raceway."""
    return 4.0 * contact.modulus * contact.length**0.9 * jnp.maximum(delta, 1e-300) ** 1.12 * contact.design_load**0.02


def full(contact, delta, spall):
    """Load over the middle of a wide spall."""
    rise = crown.height(jnp.maximum(0.5 * spall.length - jnp.abs(spall.axial_offset), 0.0), contact)
    return healthy(contact, delta - rise) * (1.0 - spall.length / contact.length) ** 0.9


def reach(contact, delta, spall):
    free = delta - 0.3 * full(contact, delta, spall) / (contact.modulus * contact.length)
    return jnp.sqrt(2.0 * contact.radius * jnp.maximum(free, 1e-12))


def load_at(contact, delta, spall, distance):
    """What the closed form gives: an edge takes the land's load away as a narrow line contact loses it."""
    sound = healthy(contact, delta)
    if spall is None:
        return sound
    over = full(contact, delta, spall)
    low, high = -half_width(contact, sound), reach(contact, delta, spall)
    t = jnp.clip((0.5 * spall.width - jnp.abs(distance) - low) / (high - low), 0.0, 1.0)
    y = 0.1 + 0.1 * t + 0.02 * jnp.log(delta / 0.005) - 0.25 * jnp.log(jnp.maximum(1.0 - t, 1e-12))
    return over + (sound - over) * (1.0 - t * t) / (1.0 + t * t * y)


def approach(contact, load, spall, distance):
    """Its inverse, by halving; the last step, Newton's, carries the derivatives."""

    def halve(_, ends):
        middle = jnp.sqrt(ends[0] * ends[1])
        low = load_at(contact, middle, spall, distance) < load
        return jnp.where(low, middle, ends[0]), jnp.where(low, ends[1], middle)

    low, high = jax.lax.fori_loop(0, 60, halve, (jnp.asarray(1e-7), jnp.asarray(0.3)))
    delta = jax.lax.stop_gradient(jnp.sqrt(low * high))
    slope = jax.lax.stop_gradient(jax.grad(load_at, 1)(contact, delta, spall, distance))
    return delta - (load_at(contact, delta, spall, distance) - load) / slope


@jax.jit
def _by_form(contact, load, spall, distance):
    value, slopes = jax.value_and_grad(approach, (0, 1, 2, 3))(contact, load, spall, distance)
    return value, slopes, half_width(contact, load), 0.0 if spall is None else reach(contact, value, spall)


def closed_form(contact, case, accuracy):
    arguments = contact, jnp.asarray(float(case.load)), case.spall, jnp.asarray(float(case.distance))
    value, (by_contact, by_load, by_spall, by_distance), width, end = _by_form(*arguments)
    slopes = np.array(samples.inputs(by_contact, by_spall, by_distance))
    return samples.Node(float(value), float(by_load), slopes, status.CONVERGED, float(width), float(end))
