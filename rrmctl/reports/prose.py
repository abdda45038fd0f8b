"""The claims of the paper's prose that a manifest of ours can test, in the order in which the paper makes them."""

from __future__ import annotations

from rrmctl.reports.claims import (
    BOX,
    FINAL,
    MEAN,
    NEAR,
    SPREAD,
    Arm,
    Budget,
    Claim,
    Reading,
    above,
    at_least,
    below,
    label_accuracy,
    residual_beyond_prior,
)

MANIPULATION = ("button-press", "door-open", "door-unlock", "sweep-into")
LOCOMOTION = ("quadruped-walk", "walker-walk")
ABLATED = ("door-unlock", "button-press")
BUTTON = ("button-press",)

RRM = ("rrm-proxy", "rrm-language", "rrm-imitation")
ON_SURF = ("rrm-surf-proxy", "rrm-surf-language", "rrm-surf-imitation")
ON_MRN = ("rrm-mrn-proxy", "rrm-mrn-language", "rrm-mrn-imitation")
PROXIES = ("proxy", "o2g", "h2o", "sparse", "language")

FULL, RARE = Budget(), Budget(every=4)
SMALL = tuple(Budget(batch=share) for share in (0.2, 0.1))
BUDGETS = (FULL, Budget(batch=0.5), *SMALL, Budget(every=2), RARE)

#: Of 500,000 steps: the first 100,000, 50,000 and 30,000.
FIRST_FIFTH = Reading(words="mean over the first fifth of the training", steps="all", until=0.2)
ACCURACY = Reading(
    words="label accuracy after a tenth of the training", until=0.1, measure=label_accuracy, unit="success"
)
PRIOR_FIRST = Reading(
    words="|residual| - |prior|, mean over the first 6 % of the training",
    steps="all",
    until=0.06,
    measure=residual_beyond_prior,
    unit="return",
)
RESIDUAL_LAST = Reading(words="|residual| - |prior|, last step", measure=residual_beyond_prior, unit="return")

CLAIMS = (
    Claim(
        name="fine-tuning-stalls",
        says="Fine-tuning an imitation reward plateaus at 20 % success",
        where="Fig. ftmain",
        experiment="finetune",
        tasks=BUTTON,
        tests=below(0.20 + NEAR, "finetune"),
    ),
    Claim(
        name="imitation-reaches-100",
        says="RRM reuses it as an additive prior and reaches 100 %",
        where="Fig. ftmain",
        experiment="finetune",
        tasks=BUTTON,
        tests=at_least(1.0 - NEAR, "rrm-imitation"),
    ),
    Claim(
        name="rrm-beyond-pebble",
        says="all RRM variants significantly outperform PEBBLE (Meta-World)",
        where="Sec. Main Results, Fig. mainbox",
        experiment="main-results",
        tasks=MANIPULATION,
        tests=above("pebble", *RRM, reading=BOX),
        pooled=True,
    ),
    Claim(
        name="rrm-quicker",
        says="RRMs substantially improve the sample efficiency of PbRL",
        where="Abstract, Fig. main",
        experiment="main-results",
        tasks=(*MANIPULATION, *LOCOMOTION),
        tests=above("pebble", *RRM),
    ),
    Claim(
        name="language-highest",
        says="RRM with language reward achieves the highest success rate",
        where="Sec. Main Results, Fig. mainbox",
        experiment="main-results",
        tasks=MANIPULATION,
        tests=(
            *above("rrm-proxy", "rrm-language", reading=BOX),
            *above("rrm-imitation", "rrm-language", reading=BOX),
        ),
        pooled=True,
    ),
    Claim(
        name="language-quickest",
        says="... and fastest policy convergence",
        where="Sec. Main Results, Fig. main",
        experiment="main-results",
        tasks=MANIPULATION,
        tests=(*above("rrm-proxy", "rrm-language"), *above("rrm-imitation", "rrm-language")),
        pooled=True,
    ),
    Claim(
        name="imitation-worse",
        says="RRM with imitation reward is slightly worse",
        where="Sec. Main Results, Fig. mainbox",
        experiment="main-results",
        tasks=MANIPULATION,
        tests=above("rrm-imitation", "rrm-proxy", "rrm-language", reading=BOX),
        pooled=True,
    ),
    Claim(
        name="locomotion-similar",
        says="Results in DM-Control are similar: RRMs end above PEBBLE",
        where="Sec. Main Results",
        experiment="main-results",
        tasks=LOCOMOTION,
        tests=above("pebble", *RRM, reading=FINAL),
    ),
    Claim(
        name="quadruped-imitation-higher",
        says="in Quadruped-walk, RRM with imitation reward achieves a higher return",
        where="Sec. Main Results",
        experiment="main-results",
        tasks=("quadruped-walk",),
        tests=(
            *above("rrm-proxy", "rrm-imitation", reading=FINAL),
            *above("rrm-language", "rrm-imitation", reading=FINAL),
        ),
    ),
    Claim(
        name="quadruped-imitation-varies",
        says="... but larger variance",
        where="Sec. Main Results",
        experiment="main-results",
        tasks=("quadruped-walk",),
        tests=(
            *above("rrm-proxy", "rrm-imitation", reading=SPREAD),
            *above("rrm-language", "rrm-imitation", reading=SPREAD),
        ),
    ),
    Claim(
        name="locomotion-language-slower",
        says="RRM with language reward converges more slowly than the proxy (DM-Control)",
        where="Sec. Main Results",
        experiment="main-results",
        tasks=LOCOMOTION,
        tests=above("rrm-language", "rrm-proxy"),
    ),
    Claim(
        name="improves-surf",
        says="RRMs consistently improve the base performance (SURF)",
        where="Fig. base (a)",
        experiment="surf",
        tasks=("button-press", "sweep-into"),
        tests=above("surf", *ON_SURF),
    ),
    Claim(
        name="improves-mrn",
        says="RRMs consistently improve the base performance (MRN)",
        where="Fig. base (b)",
        experiment="mrn",
        tasks=("door-open", "button-press"),
        tests=above("mrn", *ON_MRN),
    ),
    Claim(
        name="prior-alone-60",
        says="these prior-only baselines achieve a maximum success rate of 60 %",
        where="Sec. Ablation Studies, Fig. abla (a)",
        experiment="ablation-residual",
        tasks=ABLATED,
        tests=below(0.60 + NEAR, *(f"sac-{prior}" for prior in PROXIES)),
    ),
    Claim(
        name="residual-reaches-100",
        says="the full RRM leverages even incomplete or sparse proxy rewards to reach 100 %",
        where="Sec. Ablation Studies, Fig. abla (a)",
        experiment="ablation-residual",
        tasks=ABLATED,
        tests=at_least(1.0 - NEAR, *(f"rrm-{prior}" for prior in PROXIES)),
    ),
    Claim(
        name="residual-beyond-pebble",
        says="... significantly outperforming PEBBLE",
        where="Sec. Ablation Studies, Fig. abla (a)",
        experiment="ablation-residual",
        tasks=ABLATED,
        tests=above("pebble", *(f"rrm-{prior}" for prior in PROXIES)),
    ),
    Claim(
        name="residual-beyond-prior-alone",
        says="... and prior-only SAC",
        where="Sec. Ablation Studies, Fig. abla (a)",
        experiment="ablation-residual",
        tasks=ABLATED,
        tests=tuple(test for prior in PROXIES for test in above(f"sac-{prior}", f"rrm-{prior}")),
    ),
    Claim(
        name="zero-trails-first",
        says="RRM with zero proxy reward initially trails PEBBLE",
        where="Sec. Ablation Studies, Fig. abla (b)",
        experiment="ablation-prior",
        tasks=ABLATED,
        tests=above("rrm-zero", "pebble", reading=FIRST_FIFTH),
    ),
    Claim(
        name="opposite-reaches-100",
        says="with an opposite proxy reward RRM still achieves a 100 % success rate",
        where="Sec. Ablation Studies, Fig. abla (b)",
        experiment="ablation-prior",
        tasks=ABLATED,
        tests=at_least(1.0 - NEAR, "rrm-opposite"),
    ),
    Claim(
        name="opposite-alone-fails",
        says="... despite SAC not being able to learn from it",
        where="Sec. Ablation Studies, Fig. abla (b)",
        experiment="ablation-prior",
        tasks=ABLATED,
        tests=below(0.0 + NEAR, "sac-opposite"),
    ),
    Claim(
        name="random-robust",
        says="RRM maintains strong robustness with purely random rewards (taken as: reaches 100 % too)",
        where="Sec. Ablation Studies, Fig. abla (b)",
        experiment="ablation-prior",
        tasks=ABLATED,
        tests=at_least(1.0 - NEAR, "rrm-random"),
    ),
    Claim(
        name="pebble-needs-feedback",
        says="PEBBLE drops below 60 % when the batch is reduced to 5 or feedback comes every 20,000 steps",
        where="Sec. Robustness Analysis, Fig. less",
        experiment="less-feedback",
        tasks=MANIPULATION,
        tests=below(0.60, Arm("pebble", budget=SMALL[-1]), Arm("pebble", budget=RARE), reading=MEAN),
        pooled=True,
    ),
    Claim(
        name="rrm-needs-less",
        says="the proxy and language priors consistently achieve at least 85 % despite reduced feedback",
        where="Sec. Robustness Analysis, Fig. less",
        experiment="less-feedback",
        tasks=MANIPULATION,
        tests=at_least(
            0.85,
            *(Arm(method, budget=budget) for method in ("rrm-proxy", "rrm-language") for budget in BUDGETS),
            reading=MEAN,
        ),
        pooled=True,
    ),
    Claim(
        name="imitation-struggles",
        says="RRM with imitation reward struggles under small reward batches (taken as: below the other priors)",
        where="Sec. Robustness Analysis, Fig. less",
        experiment="less-feedback",
        tasks=MANIPULATION,
        tests=tuple(
            test
            for budget in SMALL
            for test in above(
                Arm("rrm-imitation", budget=budget),
                Arm("rrm-proxy", budget=budget),
                Arm("rrm-language", budget=budget),
            )
        ),
        pooled=True,
    ),
    Claim(
        name="stochastic-robust",
        says="RRMs maintain robust performance under stochastic noise (taken as: above the baseline)",
        where="Sec. Robustness Analysis, Tab. wrongiqm1",
        experiment="noisy-teacher",
        tasks=BUTTON,
        tests=above(Arm("pebble", "stochastic"), *(Arm(method, "stochastic") for method in RRM), reading=FINAL),
    ),
    Claim(
        name="mistaken-10-robust",
        says="... and 10 % mistaken feedback (taken as: above the baseline)",
        where="Sec. Robustness Analysis, Tab. wrongiqm1",
        experiment="noisy-teacher",
        tasks=BUTTON,
        tests=above(Arm("mrn", "mistaken-10"), *(Arm(method, "mistaken-10") for method in ON_MRN), reading=FINAL),
    ),
    Claim(
        name="mistaken-15-degrades",
        says="15 % mistaken feedback degrades performance",
        where="Sec. Robustness Analysis, Tab. wrongiqm1",
        experiment="noisy-teacher",
        tasks=BUTTON,
        tests=tuple(
            test
            for method in ON_MRN
            for test in above(Arm(method, "mistaken-15"), Arm(method, "mistaken-10"), reading=FINAL)
        ),
    ),
    Claim(
        name="mistaken-15-improves",
        says="... RRMs still demonstrate clear improvements over baselines",
        where="Sec. Robustness Analysis, Tab. wrongiqm1",
        experiment="noisy-teacher",
        tasks=BUTTON,
        tests=above(Arm("mrn", "mistaken-15"), *(Arm(method, "mistaken-15") for method in ON_MRN), reading=FINAL),
    ),
    Claim(
        name="opposite-prior-first",
        says="before 30,000 steps the total reward is mainly contributed by the opposite proxy reward",
        where="App. opposite prior, Fig. oppo (a)",
        experiment="opposite-prior",
        tasks=BUTTON,
        tests=below(0.0, "rrm-opposite", reading=PRIOR_FIRST),
    ),
    Claim(
        name="opposite-accuracy",
        says="the reward accuracy increases to nearly 100 % within 50,000 steps",
        where="App. opposite prior, Fig. oppo (a)",
        experiment="opposite-prior",
        tasks=BUTTON,
        tests=at_least(1.0 - NEAR, "rrm-opposite", reading=ACCURACY),
    ),
    Claim(
        name="opposite-residual-last",
        says="the residual reward becomes more dominant than the proxy reward",
        where="App. opposite prior, Fig. oppo (a)",
        experiment="opposite-prior",
        tasks=BUTTON,
        tests=at_least(0.0, "rrm-opposite", reading=RESIDUAL_LAST),
    ),
    Claim(
        name="opposite-slower",
        says="the misleading prior causes a slower convergence speed than PEBBLE (Door-unlock)",
        where="App. opposite prior, Fig. oppo (b)",
        experiment="opposite-prior",
        tasks=("door-unlock",),
        tests=above("rrm-opposite", "pebble", reading=MEAN),
    ),
)
