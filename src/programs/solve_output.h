// The results of solvers as tables, JSON, NPZ files and a page.
#pragma once

#include <string>

#include "output/table.h"
#include "programs/json_output.h"
#include "programs/program.h"
#include "programs/solve.h"
#include "saltus/optimality/certificate.h"

namespace saltus {

// What the conditions of the certificate are off by, relative: under its verdict, the worst of them. Nothing if there
// is nothing to certify.
std::optional<double> ResidualOf(const Certificate& certificate);

// What the verdict says of the control, in a sentence or two.
std::string MeaningOf(const Certificate& certificate);

// One row for each design parameter of each run: its values in the scene and in the solution.
Table DesignTable(const Scene& scene, const SolvedRuns& solved);
// One row a run with a certificate: verdict, residual, smallest curvature and what they mean.
Table CertificateTable(const SolvedRuns& solved);

// Adds "final_state" and "exact_final_state", and if --states asks for it "times", "states", "exact_times" and
// "exact_states". Where states do not fit into --memory_limit they are left out, and stderr says so.
void AddStates(const Request& request, const SolvedRun& run, Json* item);

// Adds what is needed to draw states: "bodies" with names and radii, "planes", and the walls that end, if there are
// any, by their keys in scene files.
void AddDrawn(const Scene& scene, Json* document);

// "contact solver", or the contact model alone where nothing was solved.
std::string LabelOfRun(const SolveReport& report);
// Those of the runs that have one, by the label of the run.
NamedStudies StudiesOf(const SolvedRuns& solved);

// <scene>_<contact>_<solver>.npz
std::string SolutionFileName(const Scene& scene, const SolveReport& report);

// Every solution as an NPZ file in --output_dir, if there is one. Throws OutputError.
void WriteSolutions(const Request& request, const SolvedRuns& solved);

class Page;

// Table of runs, certificates, replay, trajectories, controls and learning curves.
void AddSolveSections(const Request& request, const SolvedRuns& solved, Page* page);

// report.html in --output_dir, if there is one. Throws OutputError.
void WriteSolveReport(const Request& request, const SolvedRuns& solved);

}  // namespace saltus
