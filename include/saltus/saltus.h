// Everything that a first program needs: scenes, contact models and audits, problems, solvers and certificates.
//
// The headers that this one includes explain how a system (hybrid/compact_system.h), a contact model
// (simulate/force_model.h) and a problem (outer/problem.h) are written.
#pragma once

#include "saltus/outer/audit_gradient.h"
#include "saltus/outer/problem.h"
#include "saltus/outer/run.h"
