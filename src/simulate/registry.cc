#include "saltus/simulate/registry.h"

#include <glog/logging.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <utility>
#include <variant>

#include "base/number_text.h"
#include "saltus/control/contact_sequence.h"
#include "saltus/simulate/exact_run.h"
#include "scene/units.h"
#include "simulate/converted_simulator.h"
#include "simulate/forced_simulator.h"
#include "simulate/registry_entry.h"

namespace saltus {
namespace {

template <int... kIndex>
std::vector<ContactEntry> CollectEntries(std::integer_sequence<int, kIndex...>) {
  return {EntryOf<kIndex>()...};
}

const std::vector<ContactEntry>& Entries() {
  static const std::vector<ContactEntry>& entries =
      *new std::vector<ContactEntry>(CollectEntries(std::make_integer_sequence<int, SALTUS_NUM_MODELS>()));
  return entries;
}

std::string_view ModelIn(std::string_view name) { return name.substr(0, name.find(':')); }

const ContactEntry& Entry(const Contact& contact) {
  const ContactEntry* entry = contact.entry();
  CHECK(entry != nullptr) << "unknown contact model " << contact.name();
  return *entry;
}

std::string Names(const auto& all) {
  std::string names;
  for (const auto& one : all) names += (names.empty() ? "" : ", ") + std::string(one.name);
  return names;
}

// Reads "option=value" of a model, or returns the reason why it is not valid.
std::variant<OptionValue, std::string> ReadOption(const ContactEntry& entry, std::string_view text) {
  const std::string_view name = text.substr(0, text.find('='));
  const auto option = std::find_if(
      entry.options.begin(), entry.options.end(), [&](const ListedOption& known) { return known.name == name; });
  if (option == entry.options.end()) {
    return "found '" + std::string(name) + "', expected " +
           (entry.options.empty() ? "no options of " : "one of the options " + Names(entry.options) + " of ") +
           std::string(entry.traits.name);
  }
  const std::string_view digits = text.substr(std::min(text.size(), name.size() + 1));
  double value = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  const bool number = error == std::errc() && end == digits.data() + digits.size();
  if (!number || !(value >= option->low && value <= option->high) || (option->whole && value != std::floor(value))) {
    return "found '" + std::string(text) + "', expected " + std::string(name) + "= and a " +
           (option->whole ? "whole number" : "number") + " in " + ToText(option->low, 6) + ".." +
           ToText(option->high, 6);
  }
  return OptionValue{option->name, value};
}

// Reads the options behind the name of a model, or returns the reason why they are not valid.
std::variant<std::vector<OptionValue>, std::string> ReadOptions(const ContactEntry& entry, std::string_view name) {
  std::vector<OptionValue> options;
  for (size_t end = name.find(':'); end != std::string_view::npos;) {
    const size_t start = end + 1;
    end = name.find(':', start);
    const auto option = ReadOption(entry, name.substr(start, end == std::string_view::npos ? end : end - start));
    if (const auto* wrong = std::get_if<std::string>(&option)) return *wrong;
    options.push_back(std::get<OptionValue>(option));
  }
  return options;
}

std::vector<OptionValue> OptionsIn(const Contact& contact) {
  auto options = ReadOptions(Entry(contact), contact.name());
  if (const auto* wrong = std::get_if<std::string>(&options)) LOG(FATAL) << contact.name() << ": " << *wrong;
  return std::get<std::vector<OptionValue>>(std::move(options));
}

// Returns the scene in the units in which the model computes: natural ones for event-driven models, whose only
// constants are thresholds; for others SI, which the constants of their sources have, with the origin near the discs.
Scene ToModelUnits(const ContactEntry& entry, const Scene& scene) {
  const Units natural = NaturalUnits(scene);
  if (entry.traits.event_driven) return ToUnits(scene, natural);
  return ToUnits(scene, {.origin = natural.origin, .loss_at_origin = natural.loss_at_origin});
}

bool SameNumbers(const Units& a, const Units& b) {
  return a.length == b.length && a.time == b.time && a.mass == b.mass && a.origin == b.origin;
}

std::vector<ModelTraits> CollectTraits() {
  std::vector<ModelTraits> traits;
  for (const ContactEntry& entry : Entries()) traits.push_back(entry.traits);
  return traits;
}

}  // namespace

Contact Contact::WithOption(std::string_view option) const {
  Contact with = *this;
  with.name_ += ":" + std::string(option);
  return with;
}

const ContactEntry* Contact::entry() const {
  if (own_ != nullptr) return own_.get();
  for (const ContactEntry& entry : Entries()) {
    if (entry.traits.name == ModelIn(name_)) return &entry;
  }
  return nullptr;
}

const std::vector<ModelTraits>& AllContactModels() {
  static const std::vector<ModelTraits>& traits = *new std::vector<ModelTraits>(CollectTraits());
  return traits;
}

const ModelTraits* FindContactModel(const Contact& contact) {
  const ContactEntry* entry = contact.entry();
  return entry == nullptr ? nullptr : &entry->traits;
}

const std::vector<ListedOption>& OptionsOf(const Contact& contact) { return Entry(contact).options; }

std::string Validate(const Contact& contact) {
  const ContactEntry* entry = contact.entry();
  if (entry == nullptr) {
    return "found '" + std::string(ModelIn(contact.name())) +
           "', expected a contact model: " + Names(AllContactModels());
  }
  const auto options = ReadOptions(*entry, contact.name());
  const auto* wrong = std::get_if<std::string>(&options);
  return wrong == nullptr ? "" : *wrong;
}

bool HasBiasedDerivative(const Contact& contact) {
  const std::vector<ListedOption>& known = OptionsOf(contact);
  for (const OptionValue& set : OptionsIn(contact)) {
    const auto option = std::ranges::find_if(known, [&](const ListedOption& one) { return one.name == set.name; });
    if (option->biases && set.value != option->initial) return true;
  }
  return false;
}

std::string ReasonNotApplicable(const Contact& contact, const Scene& scene) {
  if (std::string wrong = Validate(contact); !wrong.empty()) return wrong;
  if (const std::optional<SceneError> error = ValidateStructure(scene))
    return "the scene is wrong: " + error->ToString();
  const ContactEntry& entry = Entry(contact);
  const Scene seen = ToModelUnits(entry, scene);
  std::string reason = entry.reason_not_applicable(seen);
  const std::string beyond = NonBallisticForces(scene);
  if (!reason.empty() || beyond.empty() || !entry.traits.event_driven) return reason;
  if (&entry != Contact(ExactModel()->name).entry()) {
    return "the scene has " + beyond +
           ", in which impacts of this model are not located: use event, or a time-stepping model such as lcp";
  }
  return UnsupportedByIntegratedScene(seen);
}

std::unique_ptr<Simulator> MakeSimulator(const Contact& contact, const Scene& scene, Precision precision) {
  const std::string reason_not_applicable = ReasonNotApplicable(contact, scene);
  CHECK(reason_not_applicable.empty()) << contact.name() << ": " << reason_not_applicable;
  const ContactEntry& entry = Entry(contact);
  const Scene seen = ToModelUnits(entry, scene);
  const bool same = SameNumbers(seen.units, scene.units);
  const auto make = [&](const Scene& in_units) -> std::unique_ptr<Simulator> {
    if (NonBallisticForces(scene).empty()) return entry.make(in_units, precision, OptionsIn(contact));
    if (entry.traits.event_driven) return MakeIntegratedScene(in_units, entry.traits);
    return AddForces(in_units, entry.make(RemoveForces(in_units), precision, OptionsIn(contact)));
  };
  std::unique_ptr<Simulator> simulator = make(same ? scene : seen);
  return same ? std::move(simulator) : ConvertUnits(scene, std::move(simulator));
}

}  // namespace saltus
