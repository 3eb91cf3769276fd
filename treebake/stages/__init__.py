"""The baking stages: one public function each; only the pipeline knows their order."""
