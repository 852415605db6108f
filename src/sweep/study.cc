#include "sweep/study.h"

#include <glog/logging.h>

#include <algorithm>

#include "base/number_text.h"
#include "base/table.h"
#include "programs/json_output.h"
#include "programs/simulators.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/scene/scene_file.h"
#include "saltus/simulate/registry.h"
#include "sweep/results.h"

namespace saltus {
namespace {

constexpr int64_t kMostPoints = 100'000'000;

bool Has(const std::vector<SweepBlock>& blocks, const std::string& option) {
  return std::ranges::any_of(
      blocks, [&](const SweepBlock& block) { return std::ranges::find(block.options, option) != block.options.end(); });
}

SweepBlock WordBlock(const std::string& option, const std::vector<std::string>& words) {
  SweepBlock block;
  block.options = {option};
  for (const std::string& word : words) block.rows.push_back({word});
  return block;
}

// Returns the sequence as a value of the flag --sequence.
std::string SequenceText(const Request& request) {
  if (request.options.sequences.given) return ContactSequenceToString(request.scene, *request.options.sequences.given);
  return request.options.sequences.search ? "auto" : "fixed";
}

// How values of options are told from others: numbers however they are written.
std::string KeyOf(const std::string& cell) {
  const std::optional<double> number = FromText<double>(cell);
  return (number ? Cell(*number).Exact() : cell) + '\n';
}

// A value that a JSON pointer leads to, or "nothing".
std::string ValueAt(const Json& document, const std::string& pointer) {
  const Json::json_pointer place(pointer);
  return document.contains(place) ? document[place].dump() : "nothing";
}

// Whether the derivative of a contact is biased, which is not known for simulators.
bool IsBiasedContact(const std::string& contact) {
  return FindSimulator(contact) == nullptr && HasBiasedDerivative(contact);
}

// Whether any contact model of the blocks has options that bias its derivative.
bool AnyContactIsBiased(const std::vector<SweepBlock>& blocks) {
  return std::ranges::any_of(blocks, [](const SweepBlock& block) {
    const auto contact = std::ranges::find(block.options, "contact");
    if (contact == block.options.end()) return false;
    return std::ranges::any_of(block.rows, [&](const SweepRow& row) {
      return IsBiasedContact(row[contact - block.options.begin()].get<std::string>());
    });
  });
}

}  // namespace

SweepStudy::SweepStudy(Request request, std::vector<SweepBlock> blocks)
    : request_(std::move(request)), blocks_(std::move(blocks)) {
  solving_ = !request_.solvers.empty() || Has(blocks_, "solver");
  if (!Has(blocks_, "contact") && KeptProgram() == nullptr) blocks_.push_back(WordBlock("contact", request_.contacts));
  if (solving_ && !Has(blocks_, "solver")) blocks_.push_back(WordBlock("solver", request_.solvers));
  generates_ = Has(blocks_, kSeedOption);
  any_bias_ = request_.options.surrogate || AnyContactIsBiased(blocks_);
  for (SweepBlock& block : blocks_) {
    std::map<std::string, int64_t>& row_of_cells = row_of_cells_.emplace_back();
    std::erase_if(block.rows, [&](const SweepRow& row) {
      std::string key;
      for (const SweepValue& value : row) key += KeyOf(CellOf(value).Exact());
      return !row_of_cells.try_emplace(key, std::ssize(row_of_cells)).second;
    });
    if (__builtin_mul_overflow(size_, std::ssize(block.rows), &size_) || size_ > kMostPoints) {
      throw InputError("--sweep has more than " + std::to_string(kMostPoints) + " points");
    }
  }
  const auto add = [&](bool names) {
    for (size_t b = 0; b < blocks_.size(); ++b) {
      for (size_t c = 0; c < blocks_[b].options.size(); ++c) {
        const std::string& option = blocks_[b].options[c];
        if ((option == "contact" || option == "solver") != names) continue;
        options_.push_back(option);
        places_.push_back({b, c});
      }
    }
  };
  add(/*names=*/false);
  add(/*names=*/true);
  columns_ = options_;
  for (const std::string& result : ResultColumns(*this)) {
    // An option may bear the name of a result.
    const bool taken = std::ranges::find(options_, result) != options_.end();
    columns_.push_back(taken ? result + std::string(kDoneSuffix) : result);
  }
}

bool SweepStudy::IsBiased(int64_t point) const {
  const size_t contact = std::ranges::find(options_, "contact") - options_.begin();
  return request_.options.surrogate || IsBiasedContact(Values(point)[contact].get<std::string>());
}

std::optional<size_t> SweepStudy::FindColumn(const std::string& name) const {
  const auto found = std::ranges::find(columns_, name);
  return found == columns_.end() ? std::nullopt : std::optional<size_t>(found - columns_.begin());
}

SweepRow SweepStudy::Values(int64_t point) const {
  CHECK(0 <= point && point < size_);
  std::vector<size_t> rows(blocks_.size());
  for (size_t b = blocks_.size(); b-- > 0;) {
    const int64_t count = static_cast<int64_t>(blocks_[b].rows.size());
    rows[b] = static_cast<size_t>(point % count);
    point /= count;
  }
  SweepRow values;
  for (const Place& place : places_) values.push_back(blocks_[place.block].rows[rows[place.block]][place.column]);
  return values;
}

std::optional<int64_t> SweepStudy::FindPoint(const std::vector<std::string>& cells) const {
  CHECK_EQ(cells.size(), places_.size());
  std::vector<std::vector<std::string>> keys(blocks_.size());
  for (size_t b = 0; b < blocks_.size(); ++b) keys[b].resize(blocks_[b].options.size());
  for (size_t i = 0; i < cells.size(); ++i) keys[places_[i].block][places_[i].column] = KeyOf(cells[i]);
  int64_t point = 0;
  for (size_t b = 0; b < blocks_.size(); ++b) {
    std::string joined;
    for (const std::string& key : keys[b]) joined += key;
    const auto found = row_of_cells_[b].find(joined);
    if (found == row_of_cells_[b].end()) return std::nullopt;
    point = point * std::ssize(blocks_[b].rows) + found->second;
  }
  return point;
}

Request SweepStudy::RequestAt(int64_t point) const {
  Request request = request_;
  const SweepRow values = Values(point);
  for (const bool seeds : {true, false}) {
    for (size_t i = 0; i < values.size(); ++i) {
      if ((options_[i] == kSeedOption) == seeds) SetSweepOption(options_[i], values[i], &request);
    }
  }
  if (const std::optional<SceneError> error = Validate(request.scene)) {
    throw InputError(error->key + ": " + error->message);
  }
  return request;
}

std::string SweepStudy::Description() const {
  Json blocks = Json::array();
  for (const SweepBlock& block : blocks_) blocks.push_back({{"options", block.options}, {"rows", block.rows}});
  Json description = {{"version", SALTUS_VERSION},
                      {"scene", Split(WriteScene(request_.scene), '\n')},
                      {"precision", request_.precision == Precision::kFloat ? "float" : "double"},
                      {"iterations", request_.options.limits.iterations},
                      {"learning_rate", request_.options.descent.learning_rate},
                      {"sequence", SequenceText(request_)},
                      {"sweep", std::move(blocks)}};
  if (const SweepProgram* program = KeptProgram()) {
    description.erase("scene");
    description["program"] = program->command;
    return description.dump();
  }
  const SearchOptions& search = request_.options.sequences.limits;
  const SearchOptions usual;
  if (search.work != usual.work) description["search_work"] = search.work;
  if (search.seconds != usual.seconds) description["search_seconds"] = search.seconds;
  if (search.memory != usual.memory) description["search_memory"] = search.memory >> 20;
  if (search.starts != usual.starts) description["search_starts"] = search.starts;
  if (search.seed != usual.seed) description["search_seed"] = search.seed;
  if (request_.options.descent.rate_per_time) description["rate_per_time"] = true;
  AddSurrogate(request_.options.surrogate, &description);
  if (const std::optional<FeedbackOptions>& feedback = request_.feedback) {
    description["feedback"] = {{"weights", {feedback->state, feedback->control, feedback->final}},
                               {"noise", feedback->deviations},
                               {"scale", feedback->scale},
                               {"plant", feedback->plant},
                               {"samples", feedback->samples},
                               {"seed", feedback->seed}};
  }
  for (const std::string& contact : request_.contacts) {
    if (const SimulatorCommand* simulator = FindSimulator(contact)) {
      description["simulators"][contact] = simulator->command;
    }
  }
  return description.dump();
}

std::string DescribeDifference(const std::string& before, const std::string& now) {
  const Json old_study = Json::parse(before, nullptr, /*allow_exceptions=*/false);
  const Json new_study = Json::parse(now);
  if (!old_study.is_object()) return "its description is not one that a sweep writes";
  const Json patch = Json::diff(old_study, new_study);
  if (patch.empty()) return "its description is written in another way";
  const std::string place = patch[0].at("path").get<std::string>();
  return place.substr(1) + ": " + ValueAt(old_study, place) + " is now " + ValueAt(new_study, place);
}

const char* ToString(PointStatus status) {
  constexpr const char* kNames[] = {"done", "failed", "not_applicable"};
  return kNames[static_cast<int>(status)];
}

std::optional<PointStatus> FindPointStatus(const std::string& text) {
  for (const PointStatus status : {PointStatus::kComputed, PointStatus::kFailed, PointStatus::kNotApplicable}) {
    if (text == ToString(status)) return status;
  }
  return std::nullopt;
}

}  // namespace saltus
