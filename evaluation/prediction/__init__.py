"""Prediction error of models: at several horizons and in simulation of whole episodes, with intervals."""
