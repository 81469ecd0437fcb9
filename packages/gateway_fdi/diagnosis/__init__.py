"""From tests that failed and tests that passed to causes: mathematics without CAN.

Components can be faulty; each test says which of them its failure blames, and with what power it sees each. A test that
fails is a *conflict*: not all of its components are well. Reiter, "A theory of diagnosis from first principles"
(1987): a diagnosis is a minimal set of components that hits every conflict (definition 2.4, theorem 4.4). De Kleer and
Williams, "Diagnosing multiple faults" (1987): diagnoses are ranked by prior times likelihood (section 4). Beyond both:
a test may alarm falsely, a test that passes speaks against a component only as much as it would have seen it, one size
of a component's error has to fit all residuals that depend on it, and a cause does not begin after its symptoms.

`system` says what there is, `state` what the tests say now, `cluster` what explains failed tests that share components,
with `sizes` for what residuals say of it; `answer` is what comes out, `apart` what would tell the rest apart;
`diagnoser` keeps it all up to date.
"""
