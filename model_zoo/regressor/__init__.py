"""Family regressor: any regressor of scikit-learn's interface as a model."""
