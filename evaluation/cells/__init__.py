"""The cells of a comparison. Each module holds the settings of some kinds and enters these into `CELL_KINDS`.

| settings | kind | result | needs |
|---|---|---|---|
| `data.GivenData`, `data.RecordedData` | data | `SplitDataset` | - |
| `models.Fit`, `models.StoredModelCell` | fit, model | a model | data; - |
| `models.Predict` | predict | `ModelPrediction` | data, fit |
| `models.ScoreFit` | score | `HeldOutScore` | data, fit |
| `models.LeaveConditionsOut` | conditions | `ConditionError` of each condition | data, fit |
| `controllers.Evolve`, `controllers.Baseline` | evolve, baseline | `Champion` | fits |
| `controllers.Choose`, `controllers.Polish` | select, polish | `Champion` | controllers, fits, predictions |
| `assessment.Run` | run | `TransferResult` | a controller, a fit |
| `assessment.AssessExploitability` | exploit | `ModelExploitability` of each model | data, fits, controllers, runs |
| `assessment.Advise` | advise | `ModelAdvice` | data, fits, predictions, controllers, runs |
| `assessment.SearchExploit` | search | `Champion` | fits, predictions |
"""
