// Certificates in words.
#pragma once

#include <string>

#include "output/table.h"
#include "programs/solve.h"
#include "saltus/optimality/certificate.h"

namespace saltus {

// What the conditions of the certificate are off by, relative: under its verdict, the worst of them. Nothing if there
// is nothing to certify.
std::optional<double> ResidualOf(const Certificate& certificate);

// What the verdict says of the control, in a sentence or two.
std::string MeaningOf(const Certificate& certificate);

// One row a run with a certificate: verdict, residual, smallest curvature and what they mean.
Table CertificateTable(const SolvedRuns& solved);

}  // namespace saltus
