"""The cells of a comparison: each computes one result, which is stored and found again by its digest.

| cell | kind | result | needs |
|---|---|---|---|
| `data.RecordedData`, `data.GivenData` | data | `Parts` | |
| `models.FitCell`, `models.StoredModel` | fit, model | a model | data |
| `models.PredictCell` | predict | `ModelPrediction` | data, fit |
| `models.ConditionsCell` | conditions | `ConditionErrors` of each condition | data, fit |
| `controllers.EvolveCell`, `controllers.HandWrittenCell` | evolve, by_hand | `Champion` | fits |
| `controllers.ChooseCell`, `controllers.PolishCell` | choose, polish | `Champion` | controllers, fits, predictions |
| `assessment.RunCell` | run | `TransferResult` | a controller, a fit |
| `assessment.ExploitCell` | exploit | `ModelExploitability` of each model | data, fits, controllers, runs |
| `assessment.AdviseCell` | advise | `ModelAdvice` | data, fits, predictions, runs |
| `assessment.SearchCell` | search | `Champion` | fits, predictions |
"""
