"""The engine: closed-loop rollouts of many candidates in many trials."""

from sysid_evo.engine.rollout import DynamicsRunner, Engine, Rollouts, Runner, available_processors, rollout

__all__ = ["DynamicsRunner", "Engine", "Rollouts", "Runner", "available_processors", "rollout"]
