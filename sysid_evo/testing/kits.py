"""The kits by kind, for whoever goes over all of them; the kit of robots is `hardware.ROBOT_KIT`."""

from sysid_evo.registry.registry import controllers, models, readers, strategies, tasks
from sysid_evo.testing import closed_loop, evolution
from sysid_evo.testing import models as model_kit
from sysid_evo.testing import readers as reader_kit
from sysid_evo.testing.contract import Kit

KITS = {
    "model": Kit(models, model_kit.run_checks, (*model_kit.FIRST_CHECKS, *model_kit.CHECKS)),
    "task": Kit(tasks, closed_loop.run_task_checks, closed_loop.TASK_CHECKS),
    "controller": Kit(controllers, closed_loop.run_controller_checks, closed_loop.CONTROLLER_CHECKS),
    "strategy": Kit(strategies, evolution.run_strategy_checks, evolution.CHECKS),
    "reader": Kit(readers, reader_kit.run_reader_checks, reader_kit.CHECKS),
}
