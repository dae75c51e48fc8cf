"""Which members of result.json are those of the run, and of the posterior, and not of a link or joint?"""

OF_RUN = ("model", "method", "seed", "iteration", "converged", "frame_id", "stamp", "certain", "max_std", "seconds")
OF_POSTERIOR = ("fit", "fit_reason", "explained", "effective_draws", "posterior_iteration")
