"""The cells of a comparison. Each module holds the settings of some kinds and enters these into `CELL_KINDS`.

| settings | kind | result | needs |
|---|---|---|---|
| `data.GivenData`, `data.RecordedData` | data | `Parts` | - |
| `models.Fit`, `models.StoredModel` | fit, model | a model | data; - |
| `models.Predict` | predict | `ModelPrediction` | data, fit |
| `models.JudgeFit` | judge | `HeldOutScore` | data, fit |
| `models.LeaveConditionsOut` | conditions | `ConditionErrors` of each condition | data, fit |
| `controllers.Evolve`, `controllers.ByHand` | evolve, by_hand | `Champion` | fits |
| `controllers.Choose`, `controllers.Polish` | choose, polish | `Champion` | controllers, fits, predictions |
| `assessment.Run` | run | `TransferResult` | a controller, a fit |
| `assessment.AssessExploitability` | exploit | `ModelExploitability` of each model | data, fits, controllers, runs |
| `assessment.Advise` | advise | `ModelAdvice` | data, fits, predictions, controllers, runs |
| `assessment.SearchExploit` | search | `Champion` | fits, predictions |
"""
