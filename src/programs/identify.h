// Parameters of a scene from recordings of its motion, and how they are told.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "programs/identify_input.h"
#include "programs/json_output.h"
#include "programs/program.h"
#include "saltus/identify/identify.h"

namespace saltus {

// Fits of the same recordings, by contact model.
struct Identified {
  std::vector<Recording> recordings;
  std::vector<std::string> contacts;
  std::vector<IdentifyReport> reports;  // of each contact model that was begun
  std::optional<KnownLaw> known_law = std::nullopt;
};

Json IdentifiedToJson(const Scene& scene, const Identified& identified);

// `saltus_identify`.
int IdentifyMain(int argc, char** argv);

}  // namespace saltus
