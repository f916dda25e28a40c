"""Which of a field's sizes do observations want otherwise: what `touchline fields measure` runs."""
