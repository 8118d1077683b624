"""Systems written after the rules of the ensembles of state spaces were fixed; nothing was changed after their results.

They have the form of those in `tests.benchmarks.hidden.systems`, with other kinds of nonlinearity.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from tests.benchmarks.hidden.systems import HiddenSystem, held_steps, hidden_system, smooth_noise, steps_and_noise

CHECKS: dict[str, HiddenSystem] = {}


@hidden_system(CHECKS, [0.3, 1.8, 0.6, 0.3, 0.8], partial(held_steps, shortest=4, longest=25), steps=1500, dt=0.1)
def input_curve(p, u):
    """A curve of the control, then a low pass and an oscillator (Hammerstein).

    p: skew and steepness of the curve, rate of the low pass, damping and frequency of the oscillator.
    """
    y = np.zeros(len(u) + 1)
    a = x = v = 0.0
    dt = 0.1 / 10.0
    for k in range(len(u)):
        curved = np.tanh(p[1] * u[k]) + p[0] * u[k] * u[k]
        for _ in range(10):
            a += dt * p[2] * (curved - a)
            v += dt * (p[4] * p[4] * (a - x) - 2.0 * p[3] * p[4] * v)
            x += dt * v
        y[k + 1] = x
    return y


@hidden_system(CHECKS, [1.5, 0.35, 0.25, 0.4], partial(smooth_noise, pole=0.85, size=0.6), steps=1500, dt=0.1)
def output_curve(p, u):
    """An oscillator seen through a root-like curve (Wiener).

    p: frequency and damping, offset and width of the curve.
    """
    y = np.zeros(len(u) + 1)
    x = v = 0.0
    dt = 0.1 / 10.0
    for k in range(len(u)):
        for _ in range(10):
            v += dt * (p[0] * p[0] * (u[k] - x) - 2.0 * p[1] * p[0] * v)
            x += dt * v
        s = x + p[2]
        y[k + 1] = s / np.sqrt(s * s + p[3] * p[3])
    return y


@hidden_system(
    CHECKS, [40.0, 1.5, 80.0, 25.0, 2.0, 20.0], partial(steps_and_noise, longest=20), steps=2000, dt=0.05, noise=0.01
)
def two_springs(p, u):
    """Two masses in a row, the first on a cubic spring; the position of the first is measured.

    p: stiffness and damping of the first, cube of its spring, stiffness and damping between them, push per control.
    """
    y = np.zeros(len(u) + 1)
    x = v = z = w = 0.0
    dt = 0.05 / 20.0
    for k in range(len(u)):
        for _ in range(20):
            between = p[3] * (z - x) + p[4] * (w - v)
            v += dt * (p[5] * u[k] - p[0] * x - p[1] * v - p[2] * x * x * x + between)
            w -= dt * between
            x += dt * v
            z += dt * w
        y[k + 1] = x
    return y


@hidden_system(CHECKS, [30.0, 40.0, 12.0, 3.0, 0.5, 1.2], partial(steps_and_noise, longest=30), steps=1500, dt=0.02)
def motor(p, u):
    """A motor with dry friction and an armature that saturates; the speed is measured, the current is not.

    p: resistance by inductance, voltage by inductance, torque, friction, dry friction, current of saturation.
    """
    y = np.zeros(len(u) + 1)
    v = i = 0.0
    dt = 0.02 / 20.0
    for k in range(len(u)):
        for _ in range(20):
            i += dt * (p[1] * (u[k] - 0.3 * v) - p[0] * i)
            v += dt * (p[2] * i / (1.0 + abs(i) / p[5]) - p[3] * v - p[4] * np.tanh(v / 0.02))
        y[k + 1] = v
    return y


@hidden_system(CHECKS, [0.5, 0.6, 0.25, 0.4], partial(held_steps, shortest=8, longest=40), steps=1200, dt=0.5)
def heat_exchanger(p, u):
    """A heated wall and a flow that the control changes, seen three samples later behind a sensor with a lag.

    p: exchange, part of the flow that the control changes, wall's rate, rate of the sensor.
    """
    y = np.zeros(len(u) + 1)
    wall, water, seen = 1.0, 0.5, 0.5
    y[0] = seen
    piped = np.full(4, 0.5)
    dt = 0.5 / 10.0
    for k in range(len(u)):
        flow = 0.5 * (1.0 + p[1] * u[k])
        for _ in range(10):
            passed = p[0] * (wall - water)
            wall += dt * p[2] * (1.5 - wall - passed)
            water += dt * (passed - flow * water)
            seen += dt * p[3] * (piped[0] - seen)
        piped[:3] = piped[1:]
        piped[3] = water
        y[k + 1] = seen
    return y


@hidden_system(CHECKS, [0.4, 0.15, 6.0, 0.3], partial(held_steps, shortest=6, longest=30), steps=1500, dt=0.5)
def neutralisation(p, u):
    """A tank in which acid and base neutralise each other; a titration curve follows, and an electrode with a lag.

    p: rate of the tank, surplus of acid, steepness of the curve, rate of the electrode.
    """
    y = np.zeros(len(u) + 1)
    surplus = seen = 0.0
    dt = 0.5 / 10.0
    for k in range(len(u)):
        for _ in range(10):
            surplus += dt * p[0] * (0.5 * u[k] - p[1] - surplus)
            curve = np.arcsinh(p[2] * surplus) - np.arcsinh(0.0)
            seen += dt * p[3] * (curve - seen)
        y[k + 1] = seen
    return y


@hidden_system(CHECKS, [1.5, 3.0, 4.0, 0.05, 0.02], partial(held_steps, shortest=5, longest=40), steps=1500, dt=0.2)
def drive_and_brake(p, u):
    """A vehicle that an engine with a lag drives and a faster brake slows down; its speed is measured.

    p: lag of the engine, its force, that of the brake, friction, drag.
    """
    y = np.zeros(len(u) + 1)
    v = push = 0.0
    dt = 0.2 / 10.0
    for k in range(len(u)):
        for _ in range(10):
            push += dt * (max(u[k], 0.0) - push) / p[0]
            braked = p[2] * min(max(-u[k], 0.0), 0.5) * np.tanh(v / 0.1)
            v = v + dt * (p[1] * push - braked - p[3] * v - p[4] * v * abs(v))
        y[k + 1] = v
    return y


@hidden_system(CHECKS, [4.0, 0.3, 1.2, 9.81, 0.1, 6.0], partial(smooth_noise, pole=0.9, size=0.7), steps=2000, dt=0.1)
def crane(p, u):
    """A trolley that pulls a swinging load; the speed of the trolley is measured.

    p: friction of the trolley, mass of the load by that of the trolley, length, gravity, damping of the swing, push.
    """
    y = np.zeros(len(u) + 1)
    v = angle = w = 0.0
    dt = 0.1 / 20.0
    for k in range(len(u)):
        for _ in range(20):
            s, c = np.sin(angle), np.cos(angle)
            pulled = p[5] * u[k] - p[0] * v + p[1] * s * (p[2] * w * w + p[3] * c)
            a = pulled / (1.0 + p[1] * s * s)
            v += dt * a
            w -= dt * ((c * a + p[3] * s) / p[2] + p[4] * w)
            angle += dt * w
        y[k + 1] = v
    return y
