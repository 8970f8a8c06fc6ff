"""One file for each method: TITLE, NEEDS, NAMES and ``examine(case, without, seed)``, as ``answer.Method`` says."""
