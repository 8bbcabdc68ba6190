"""Programs that go further than the tests. From the root of the repository: python -m tools.bench.cycle."""
