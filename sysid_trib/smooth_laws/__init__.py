"""Laws: friction against speed and restoring force against displacement, as curves with bands."""
