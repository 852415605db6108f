# What measurements of an engine say: verdict, motion and class, in the words of saltus_audit.
import math

RIGHT = 1e-6  # relative error of a gradient
SETTLED = 0.5  # an error that falls with the step is, at the finest, below this part of that at the coarsest
SMALL = 0.1  # ... and below this
NEGLIGIBLE = 1e-3  # of the exact gradient: a component whose sign does not matter


def norm(vector):
    return math.sqrt(sum(x * x for x in vector))


# |a - b| / |b|
def relative_error(a, b):
    return norm([x - y for x, y in zip(a, b)]) / norm(b)


# The errors of the gradient, by step count from the coarsest.
def gradient_errors(study, exact):
    return [relative_error(study["by_step"][steps][1], exact["gradient"]) for steps in sorted(study["by_step"], key=int)]


def loss_errors(study, exact):
    return [abs(study["by_step"][steps][0] - exact["loss"]) / exact["loss"] for steps in sorted(study["by_step"], key=int)]


def falls(errors):
    return errors[-1] < SMALL and errors[-1] < SETTLED * max(errors[0], errors[1])


# Of the gradient: right, consistent, wrong or wrong sign.
def of_gradient(study, exact, float32):
    errors = gradient_errors(study, exact)
    if max(errors[-4:]) < (1e-3 if float32 else RIGHT):
        return "right"
    if falls(errors):
        return "consistent"
    finest = study["by_step"][max(study["by_step"], key=int)][1]
    size = norm(exact["gradient"])
    wrong_signs = [x for x, y in zip(finest, exact["gradient"])
                   if x * y < 0 and min(abs(x), abs(y)) > NEGLIGIBLE * size]
    return "wrong sign" if wrong_signs else "wrong"


# Of the motion: whether the loss goes to the exact one.
def of_motion(study, exact):
    errors = loss_errors(study, exact)
    return "converges" if errors[-1] < NEGLIGIBLE or falls(errors) else "does not converge"


# How the engine makes contact, from a head-on impact (measure.impact) at a coarse and a fine step.
def of_contact(study, restitution=1):
    coarse, fine = study["impact"]["240"], study["impact"]["2400"]
    if isinstance(coarse, str) or isinstance(fine, str):
        return "not recognised"
    lost = "; rebound lost at fine steps" if fine["e"] < 0.8 * restitution < coarse["e"] else ""

    def near(name, value, tolerance=0.05):
        return all(abs(impact[name] - value) < tolerance for impact in (coarse, fine))

    if coarse["e"] < 0.5 * restitution and fine["e"] < 0.5 * restitution:
        return "no restitution"
    if min(abs(coarse["feed"]), abs(fine["feed"])) > 0.03:
        return "depth feedback" + lost
    if near("keep", -restitution):
        return "impact time resolved, or a resolved force"
    if abs(fine["keep"] + restitution) < 0.1:
        return "force, not resolved at coarse steps"
    if near("keep", 1) or (lost and abs(coarse["keep"] - 1) < 0.05):
        return "impulse at a step boundary" + lost
    if abs(fine["keep"]) < 0.1:
        return "projection" + ("" if abs(coarse["keep"]) < 0.1 else ", at coarse steps impulse at a step boundary")
    return "displacement overcorrected" if near("keep", -2) else "not recognised"
