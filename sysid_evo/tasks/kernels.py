"""Lane code of tasks that is written by hand: waypoints, walls, shells around scalar laws."""

from __future__ import annotations

import math

from sysid_evo.kernels import (
    LANES,
    QUARTER,
    Layout,
    first_lane,
    lanes_at_most,
    load,
    load_quarter,
    nearest,
    splat,
    splat_quarter,
    store,
    view,
    where_bits,
)
from sysid_evo.motion_kernels import wrap
from sysid_evo.tasks.track_geometry import NOWHERE, NUMBERS, STILL, WALK

ROWS = Layout(
    "furthest", "alive", "x", "y", "heading", "progress", "turned", "touches",
    "first_x", "first_y", "way_x", "way_y", "offset", "rise_x", "rise_y", "moving", "track",
)  # fmt: skip

HEAD = Layout("forward", "lateral", "yaw_rate", "dt", "half", "room", "ends", "reach", "rays")


def observe(task, state, observation, parameters):
    """Bias, forward speed, yaw rate, and how far the wall is along each ray; the first step is shared by all rays."""
    forward = view(state, int(parameters[HEAD.forward]) * LANES)
    yaw_rate = view(state, int(parameters[HEAD.yaw_rate]) * LANES)
    track, half, reach = view(task, ROWS.track * LANES), parameters[HEAD.half], parameters[HEAD.reach]
    xs, ys, headings = view(task, ROWS.x * LANES), view(task, ROWS.y * LANES), view(task, ROWS.heading * LANES)
    ways_x, ways_y = view(task, ROWS.way_x * LANES), view(task, ROWS.way_y * LANES)
    offsets, moving = view(task, ROWS.offset * LANES), view(task, ROWS.moving * LANES)
    rises_x, rises_y = view(task, ROWS.rise_x * LANES), view(task, ROWS.rise_y * LANES)
    least, greatest = view(track, (NUMBERS - 2) * LANES), view(track, (NUMBERS - 1) * LANES)
    for lane in range(LANES):
        observation[lane] = 1.0
        observation[LANES + lane] = forward[lane]
        observation[2 * LANES + lane] = yaw_rate[lane]
        offsets[lane], rises_x[lane], rises_y[lane] = level(track, lane, xs[lane], ys[lane])
    for ray in range(int(parameters[HEAD.rays])):
        gone, direction = view(observation, (3 + ray) * LANES), parameters[HEAD.size + ray]
        for lane in range(LANES):
            angle = headings[lane] + direction
            way_x, way_y = math.cos(angle), math.sin(angle)
            ways_x[lane], ways_y[lane] = way_x, way_y
            rise = rises_x[lane] * way_x + rises_y[lane] * way_y
            step = step_to_wall(offsets[lane], rise, half, least[lane], greatest[lane])
            gone[lane] = min(max(step, 0.0), reach)
            moving[lane] = 1.0 if gone[lane] > STILL else 0.0
        for _ in range(WALK - 1):
            still_moving = 0
            for lane in range(LANES):
                still_moving += 1 if moving[lane] > 0.0 else 0
            if still_moving == 0:
                break
            for lane in range(LANES):
                way_x, way_y, far = ways_x[lane], ways_y[lane], gone[lane]
                offset, rise_x, rise_y = level(track, lane, xs[lane] + far * way_x, ys[lane] + far * way_y)
                rise = rise_x * way_x + rise_y * way_y
                step = step_to_wall(offset, rise, half, least[lane], greatest[lane])
                gone[lane] = min(max(far + step, 0.0), reach) if moving[lane] > 0.0 else far
                moving[lane] = 1.0 if abs(gone[lane] - far) > STILL else 0.0


def advance(task, before, after, control, trials, trial_data, parameters):
    """Let the motion move the pose, measure the way, and stop at the walls."""
    room, ends = parameters[HEAD.room], parameters[HEAD.ends]
    xs, ys, track = view(task, ROWS.x * LANES), view(task, ROWS.y * LANES), view(task, ROWS.track * LANES)
    first_x, first_y = view(task, ROWS.first_x * LANES), view(task, ROWS.first_y * LANES)
    for lane in range(LANES):
        first_x[lane] = xs[lane] - track[lane]
        first_y[lane] = ys[lane] - track[LANES + lane]
    own = view(parameters, HEAD.size + int(parameters[HEAD.rays]))
    move(xs, before, after, parameters[HEAD.dt], own)
    forward, lateral = view(after, int(parameters[HEAD.forward]) * LANES), int(parameters[HEAD.lateral])
    sideways = view(after, max(lateral, 0) * LANES)
    for lane in range(LANES):
        dx, dy, x, y = first_x[lane], first_y[lane], xs[lane] - track[lane], ys[lane] - track[LANES + lane]
        turned = math.atan2(dx * y - dy * x, dx * x + dy * y)
        distance = math.sqrt(x * x + y * y) + NOWHERE
        cosine, sine = x / distance, y / distance
        middle, slope, _ = centre_line(track, lane, cosine, sine)
        per_radian = math.sqrt(middle * middle + slope * slope)
        offset = (distance - middle) * middle / per_radian
        progress = task[ROWS.progress * LANES + lane] + turned * per_radian
        task[ROWS.progress * LANES + lane] = progress
        task[ROWS.turned * LANES + lane] += turned
        task[lane] = max(task[lane], progress)
        touching = 1.0 if abs(offset) > room + PRESSED else 0.0
        task[ROWS.touches * LANES + lane] += touching
        task[LANES + lane] = 0.0 if touching * ends > 0.0 else task[LANES + lane]
        stopped = touching * (1.0 - ends)
        stop = middle + min(max(offset, -room), room) * per_radian / middle
        xs[lane] = track[lane] + stop * cosine if stopped > 0.0 else xs[lane]
        ys[lane] = track[LANES + lane] + stop * sine if stopped > 0.0 else ys[lane]
        kept = KEPT if stopped > 0.0 else 1.0
        forward[lane] *= kept
        sideways[lane] *= kept if lateral >= 0 else 1.0


def level(track, lane, x, y):
    """Return the offset of one point, and how fast it grows along x and along y, as `Place`."""
    dx, dy = x - track[lane], y - track[LANES + lane]
    square = dx * dx + dy * dy + NOWHERE * NOWHERE
    inverse = 1.0 / math.sqrt(square)
    distance, cosine, sine = square * inverse, dx * inverse, dy * inverse
    middle, slope, bend = centre_line(track, lane, cosine, sine)
    along = 1.0 / math.sqrt(middle * middle + slope * slope)
    outwards, beyond = middle * along, distance - middle
    turned = slope * (slope * slope - middle * bend) * (along * along * along)
    across = (beyond * turned - slope * outwards) * inverse
    return beyond * outwards, outwards * cosine - across * sine, outwards * sine + across * cosine


def centre_line(track, lane, cosine, sine):
    """Return r, r' and r'' of the centre line in one direction."""
    c2, s2 = cosine * cosine - sine * sine, 2.0 * sine * cosine
    c3, s3 = c2 * cosine - s2 * sine, s2 * cosine + c2 * sine
    c4, s4 = c2 * c2 - s2 * s2, 2.0 * s2 * c2
    c5, s5 = c3 * c2 - s3 * s2, s3 * c2 + c3 * s2
    a2, b2, a3, b3 = track[3 * LANES + lane], track[4 * LANES + lane], track[5 * LANES + lane], track[6 * LANES + lane]
    a4, b4, a5, b5 = track[7 * LANES + lane], track[8 * LANES + lane], track[9 * LANES + lane], track[10 * LANES + lane]
    w2, w3, w4, w5 = a2 * c2 + b2 * s2, a3 * c3 + b3 * s3, a4 * c4 + b4 * s4, a5 * c5 + b5 * s5
    middle = track[2 * LANES + lane] + w2 + w3 + (w4 + w5)
    slope = (
        2.0 * (b2 * c2 - a2 * s2) + 3.0 * (b3 * c3 - a3 * s3) + 4.0 * (b4 * c4 - a4 * s4) + 5.0 * (b5 * c5 - a5 * s5)
    )
    return middle, slope, -(4.0 * w2 + 9.0 * w3 + (16.0 * w4 + 25.0 * w5))


def step_to_wall(offset, rise, half, least, greatest):
    """`sysid_evo.tasks.track_geometry.step_to_wall` of one point."""
    outer, inner = half - offset, half + offset
    lead, room = (1.0 + greatest * offset) * rise, outer * (2.0 + greatest * inner)
    out = max(lead + math.sqrt(max(lead * lead + greatest * room, 0.0)), NOWHERE)
    lead_in, room_in = (1.0 + least * offset) * rise, inner * (2.0 - least * outer)
    root = lead_in * lead_in - least * room_in
    within = max(math.sqrt(max(root, 0.0)) - lead_in if root >= 0.0 else 0.0, NOWHERE)
    sooner = room * within < room_in * out  # one division instead of two
    return (room if sooner else room_in) / (out if sooner else within)


REWARD_ROWS = Layout("score", "alive", "pose")
"""After the pose comes one row in which the state and control of a lane stand side by side."""

OWN = Layout("lowest", "share")


def reward_advance(task, before, after, control, trials, trial_data, parameters):
    """Move the pose and add the reward of the state in which the control was given."""
    nx, nu, n_pose = (
        int(parameters[FOLLOWING_HEAD.nx]),
        int(parameters[FOLLOWING_HEAD.nu]),
        int(parameters[FOLLOWING_HEAD.n_pose]),
    )
    own = view(parameters, int(parameters[FOLLOWING_HEAD.of_nu]))
    pose = view(task, REWARD_ROWS.pose * LANES)
    x = view(pose, n_pose * LANES)
    u = view(x, nx)
    move(
        pose, before, after, parameters[FOLLOWING_HEAD.dt], view(parameters, int(parameters[FOLLOWING_HEAD.of_motion]))
    )
    lowest, share = own[OWN.lowest], own[OWN.share]
    for lane in range(LANES):
        for i in range(nx):
            x[i] = before[i * LANES + lane]
        for j in range(nu):
            u[j] = control[j * LANES + lane]
        reward = worth(x, u)
        task[lane] += share * (reward if reward >= lowest else lowest)
        for i in range(nx):
            x[i] = after[i * LANES + lane]
        if over(x, u):
            task[REWARD_ROWS.alive * LANES + lane] = 0.0


def never(x, u):
    """No trial is over before its time."""
    return 0.0


WAYPOINTS_ROWS = Layout("passed", "alive", "x", "y", "heading", "next_x", "next_y")

WAYPOINTS_HEAD = Layout("forward", "yaw_rate", "dt", "radius_squared", "n_data")


def waypoints_observe(task, state, observation, parameters):
    """Bias, forward speed, yaw rate, angle and distance to the waypoint."""
    forward = view(state, int(parameters[WAYPOINTS_HEAD.forward]) * LANES)
    yaw_rate = view(state, int(parameters[WAYPOINTS_HEAD.yaw_rate]) * LANES)
    store(observation, 0, splat(1.0))
    store(observation, LANES, load(forward, 0))
    store(observation, 2 * LANES, load(yaw_rate, 0))
    for lane in range(0, LANES, QUARTER):
        here, seen = view(task, lane), view(observation, lane)
        dx = load_quarter(here, WAYPOINTS_ROWS.next_x * LANES) - load_quarter(here, WAYPOINTS_ROWS.x * LANES)
        dy = load_quarter(here, WAYPOINTS_ROWS.next_y * LANES) - load_quarter(here, WAYPOINTS_ROWS.y * LANES)
        store(seen, 3 * LANES, wrap(math.atan2(dy, dx) - load_quarter(here, WAYPOINTS_ROWS.heading * LANES)))
        store(seen, 4 * LANES, math.sqrt(dx * dx + dy * dy))


def waypoints_advance(task, before, after, control, trials, trial_data, parameters):
    """Let the motion move the pose, and pass the waypoints within reach."""
    reach = parameters[WAYPOINTS_HEAD.radius_squared]
    move(
        view(task, WAYPOINTS_ROWS.x * LANES),
        before,
        after,
        parameters[WAYPOINTS_HEAD.dt],
        view(parameters, WAYPOINTS_HEAD.size),
    )
    dx = load(task, WAYPOINTS_ROWS.next_x * LANES) - load(task, WAYPOINTS_ROWS.x * LANES)
    dy = load(task, WAYPOINTS_ROWS.next_y * LANES) - load(task, WAYPOINTS_ROWS.y * LANES)
    passing = lanes_at_most(dx * dx + dy * dy, splat(reach))
    while passing != 0:
        lane = first_lane(passing)
        passing &= passing - 1
        number = task[WAYPOINTS_ROWS.passed * LANES + lane] + 1.0
        place = trials[lane] * int(parameters[WAYPOINTS_HEAD.n_data]) + 2 * int(number)
        put(view(task, WAYPOINTS_ROWS.passed * LANES), lane, number)
        put(view(task, WAYPOINTS_ROWS.next_x * LANES), lane, trial_data[place])
        put(view(task, WAYPOINTS_ROWS.next_y * LANES), lane, trial_data[place + 1])


def put(row, lane, number):
    """Write one lane of a row by way of its quarter: a row read soon after a single number was written waits for it."""
    first = lane - lane % QUARTER
    store(row, first, where_bits(1 << (lane % QUARTER), splat_quarter(number), load_quarter(row, first)))


FOLLOWING_ROWS = Layout("score", "alive", "step", "squared", "late", "reached", "beyond", "pose")
"""The pose is followed by the target of each channel now, and its first error."""

FOLLOWING_HEAD = Layout(
    "nx", "nu", "goals", "dt", "n_pose", "gain", "effort", "stride", "n_data", "of_goals", "of_nu", "of_motion"
)

STATE = Layout("turn", "centre", "scale")

GOAL = Layout("place", "period", "per_tolerance", "per_still", "turn", "scale", "end")

CONTROL = Layout("neutral", "full")

NEVER = 1e30


def following_advance(task, before, after, control, trials, trial_data, parameters):
    """Take the next target, and score how near the state is to it."""
    nu, goals, n_pose = (
        int(parameters[FOLLOWING_HEAD.nu]),
        int(parameters[FOLLOWING_HEAD.goals]),
        int(parameters[FOLLOWING_HEAD.n_pose]),
    )
    gain, effort = parameters[FOLLOWING_HEAD.gain], parameters[FOLLOWING_HEAD.effort]
    pose, per_dt = view(task, FOLLOWING_ROWS.pose * LANES), 1.0 / parameters[FOLLOWING_HEAD.dt]
    targets, firsts = view(pose, n_pose * LANES), view(pose, (n_pose + goals) * LANES)
    move(
        pose, before, after, parameters[FOLLOWING_HEAD.dt], view(parameters, int(parameters[FOLLOWING_HEAD.of_motion]))
    )
    step, stride, n_data = (
        view(task, FOLLOWING_ROWS.step * LANES),
        int(parameters[FOLLOWING_HEAD.stride]),
        int(parameters[FOLLOWING_HEAD.n_data]),
    )
    late, reached, beyond = (
        view(task, FOLLOWING_ROWS.late * LANES),
        view(task, FOLLOWING_ROWS.reached * LANES),
        view(task, FOLLOWING_ROWS.beyond * LANES),
    )
    for lane in range(LANES):
        step[lane] += 1.0
    if stride > 0:
        for lane in range(LANES):
            place = trials[lane] * n_data + min(int(step[lane]) * stride, n_data - goals)
            for i in range(goals):
                targets[i * LANES + lane] = trial_data[place + i]
    for lane in range(LANES):
        squares, moving, off, past, over = 0.0, 0.0, 0.0, -NEVER, 0.0
        for i in range(goals):
            p = view(parameters, int(parameters[FOLLOWING_HEAD.of_goals]) + i * GOAL.size)
            now, period = after[int(p[GOAL.place]) * LANES + lane], p[GOAL.period]
            error, change = targets[i * LANES + lane] - now, now - before[int(p[GOAL.place]) * LANES + lane]
            error = nearest_way(error, period) if period > 0.0 else error
            change = nearest_way(change, period) if period > 0.0 else change
            rate = change * per_dt * p[GOAL.per_still]
            moving += rate * rate
            share, first = error * p[GOAL.per_tolerance], firsts[i * LANES + lane]
            squares += share * share
            off = 1.0 if abs(share) > 1.0 else off
            over = 1.0 if abs(error) > p[GOAL.end] else over
            way = (1.0 if first > 0.0 else 0.0) - (1.0 if first < 0.0 else 0.0)
            past = max(past, -way * share / max(abs(first) * p[GOAL.per_tolerance], 1.0))
        power = 0.0
        for j in range(nu):
            c = view(parameters, int(parameters[FOLLOWING_HEAD.of_nu]) + j * CONTROL.size)
            full = (control[j * LANES + lane] - c[CONTROL.neutral]) * c[CONTROL.full]
            power += full * full
        power = power / float(nu) if nu > 0 else 0.0
        task[lane] += gain * (1.0 / (1.0 + squares + moving) + effort * (1.0 - power))
        task[LANES + lane] = 0.0 if over > 0.0 else task[LANES + lane]
        task[FOLLOWING_ROWS.squared * LANES + lane] += squares
        late[lane] = step[lane] if off > 0.0 else late[lane]
        reached[lane] = 1.0 if off == 0.0 else reached[lane]
        beyond[lane] = max(beyond[lane], past) if reached[lane] > 0.0 else beyond[lane]


def nearest_way(error, period):
    """Return ``error`` within half a period of 0, as `sysid_evo.angles.wrap` does."""
    error = error - period * nearest(error / period)
    return error + period if error <= -0.5 * period else error


KEPT = 0.5
"""Share of its speed that a body keeps in each step at a wall."""

PRESSED = 1e-6
"""How far (m) beyond its place at a wall a body touches it: one that rests there does not."""
