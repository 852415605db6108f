#include "blackbox/command_scheme.h"

#include <poll.h>

#include <limits>
#include <utility>
#include <vector>

#include "blackbox/conversation.h"
#include "blackbox/protocol.h"

namespace saltus {
namespace {

constexpr std::size_t kMostCharacters = 1 << 20;  // of an answer

ProtocolJson NumbersOf(const double* numbers, int count) { return std::vector<double>(numbers, numbers + count); }

template <typename Name>
ProtocolJson NamesOf(int count, const Name& name) {
  ProtocolJson names = ProtocolJson::array();
  for (int i = 0; i < count; ++i) names.push_back(name(i));
  return names;
}

}  // namespace

ProtocolJson NamesToJson(const HybridSystem& system) {
  ProtocolJson modes = ProtocolJson::array();
  for (int mode = 0; mode < system.functions().num_base_modes(); ++mode) {
    modes.push_back({{"name", system.ModeName(mode)},
                     {"states", NamesOf(system.state_size(mode), [&](int i) { return system.StateName(mode, i); })}});
  }
  return {{"modes", std::move(modes)},
          {"controls", NamesOf(system.num_controls(), [&](int i) { return system.ControlName(i); })},
          {"parameters", NamesOf(system.num_parameters(), [&](int i) { return system.ParameterName(i); })}};
}

CommandScheme::CommandScheme(const HybridSystem& system, CommandOptions options, const ProtocolJson& scene)
    : system_(system),
      options_(std::move(options)),
      conversation_(std::make_unique<Conversation>(options_.command, options_.on_error_line)) {
  ProtocolJson hello = {{"saltus", 1}, {"hybrid", NamesToJson(system)}};
  if (!scene.is_null()) hello["scene"] = scene;
  const std::string line = Answer(hello.dump(), "the greeting");
  if (!broken_.empty()) return;
  const ProtocolJson greeting = ProtocolJson::parse(line, nullptr, /*allow_exceptions=*/false);
  if (!greeting.is_object()) {
    broken_ = "found " + Excerpt(line) + ", expected an object with \"name\", \"can\" or \"not_applicable\"";
  } else if (greeting.contains("not_applicable")) {
    broken_ = greeting["not_applicable"].is_string() ? greeting["not_applicable"].get<std::string>() : "not applicable";
  } else if (greeting.contains("can")) {
    const ProtocolJson& can = greeting["can"];
    has_jacobian_ = can == "jacobian" || (can.is_array() && can.size() == 1 && can[0] == "jacobian");
    if (!has_jacobian_ && !can.empty()) {
      broken_ = "found " + Excerpt(can.dump()) + " as \"can\", expected [\"jacobian\"] or nothing";
    }
  }
}

CommandScheme::~CommandScheme() = default;

std::string CommandScheme::Answer(const std::string& line, const std::string& what) {
  std::string answer;
  bool answered = false;
  conversation_->Send(line, {0, what, kMostCharacters});
  while (!answered && conversation_->failure().empty()) {
    conversation_->Write();
    std::vector<pollfd> waited;
    conversation_->AddTo(&waited);
    poll(waited.data(), waited.size(), kLook);
    conversation_->Exchange([&](const Expected&, const std::string& found) {
      answer = found;
      answered = true;
    });
    conversation_->CheckTime(options_.seconds);
  }
  if (!answered) broken_ = "'" + options_.command + "': " + conversation_->failure();
  return answer;
}

int CommandScheme::Ask(const SchemeStep& step, double* next, double* jacobian, std::string* error) {
  const auto fail = [&](const std::string& why) {
    *error = broken_ = why;
    return -1;
  };
  if (!broken_.empty()) return fail(broken_);
  const int n = system_.state_size(step.mode), m = system_.num_controls(), P = system_.num_parameters();
  const std::int64_t id = next_id_++;
  ProtocolJson asked = {{"mode", system_.ModeName(step.mode)},
                        {"t", step.t},
                        {"h", step.h},
                        {"state", NumbersOf(step.x, n)},
                        {"control", NumbersOf(step.u, m)},
                        {"parameters", NumbersOf(step.p, P)}};
  if (jacobian != nullptr) asked["jacobian"] = true;
  const std::string what = "request " + std::to_string(id) + " (step)";
  const std::string line = Answer(ProtocolJson({{"id", id}, {"step", std::move(asked)}}).dump(), what);
  if (!broken_.empty()) return fail(broken_);
  const ProtocolJson json = ProtocolJson::parse(line, nullptr, /*allow_exceptions=*/false);
  try {
    if (!json.is_object() || !json.contains("id") || json["id"] != id) {
      return fail("found " + Excerpt(line) + ", expected an object with \"id\": " + std::to_string(id));
    }
    if (json.contains("error")) {
      *error = json["error"].is_string() ? json["error"].get<std::string>() : json["error"].dump();
      return -1;
    }
    int mode = 0;
    const std::string name = json.value("mode", std::string());
    while (mode < system_.num_modes() && system_.ModeName(mode) != name) ++mode;
    if (mode == system_.num_modes()) return fail(what + ": found mode '" + name + "', which does not exist");
    const std::size_t size = system_.state_size(mode), columns = n + m + P;
    const std::vector<double> state = NumbersFrom(json.value("state", ProtocolJson()), {size}, "\"state\"");
    std::copy(state.begin(), state.end(), next);
    for (const double number : state) is_float32_ = is_float32_ && number == static_cast<float>(number);
    if (jacobian == nullptr) return mode;
    const std::vector<double> rows =
        NumbersFrom(json.value("jacobian", ProtocolJson()), {size, columns}, "\"jacobian\"");
    std::copy(rows.begin(), rows.end(), jacobian);
    return mode;
  } catch (const std::exception& wrong) {
    return fail(what + ": " + wrong.what());
  }
}

int CommandScheme::Step(const SchemeStep& step, double* next, double* jacobian, std::string* error) {
  if (jacobian == nullptr || has_jacobian_) return Ask(step, next, jacobian, error);
  const StepFunction ask = [this](const SchemeStep& at, double* after, std::string* why) {
    return Ask(at, after, nullptr, why);
  };
  if (next_id_ == 1 && Ask(step, next, nullptr, error) < 0) return -1;  // to know the precision
  const double precision = is_float32_ ? std::numeric_limits<float>::epsilon() : std::numeric_limits<double>::epsilon();
  return DifferenceStep(system_, step, ask, next, jacobian, error, precision);
}

}  // namespace saltus
