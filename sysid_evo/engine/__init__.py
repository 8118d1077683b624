"""The engine: closed-loop rollouts of many candidates in many trials."""

from sysid_evo.engine.rollout import DynamicsRunner, Rollouts, Runner, rollout

__all__ = ["DynamicsRunner", "Rollouts", "Runner", "rollout"]
