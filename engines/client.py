# Runs a driver and asks it for final states: the other side of the protocol.
import json
import os
import subprocess

# The command could not be run, or did not answer as agreed.
class DriverError(Exception):
    pass


# What the driver says it cannot take.
class NotApplicable(Exception):
    pass


# Answers of one process to all requests, [(steps, duration, initial, control), ...], as lists of final states.
def final_states(command, scene, requests, seconds=600):
    lines = [json.dumps({"saltus": 1, "scene": scene})]
    for number, (steps, duration, initial, control) in enumerate(requests):
        simulate = {"steps": steps, "duration": duration, "initial": initial, "control": control}
        lines.append(json.dumps({"id": number, "simulate": simulate}))
    try:
        done = subprocess.run(command, input="\n".join(lines) + "\n", capture_output=True, text=True, timeout=seconds,
                              env=dict(os.environ, NODE_NO_WARNINGS="1"))
    except (OSError, subprocess.TimeoutExpired) as error:
        raise DriverError(str(error)) from error
    try:
        answers = [json.loads(line) for line in done.stdout.splitlines()]
    except ValueError as error:
        raise DriverError(f"not JSON: {done.stdout[:200]}") from error
    if not answers:
        raise DriverError(f"no answer (exit code {done.returncode}): {done.stderr.strip()[-400:]}")
    if "not_applicable" in answers[0]:
        raise NotApplicable(answers[0]["not_applicable"])
    for answer in answers:
        if "error" in answer:
            raise DriverError(answer["error"])
    if [answer.get("id") for answer in answers[1:]] != list(range(len(requests))):
        raise DriverError(f"{len(answers) - 1} answers to {len(requests)} requests: {done.stderr.strip()[-400:]}")
    return [answer["final"] for answer in answers[1:]]
