#include "saltus/simulate/learned_contact.h"

#include <glog/logging.h>

#include "contact/event/learned_events.h"
#include "saltus/simulate/user_contact.h"

namespace saltus {

Contact LearnedContact(const ImpactLaw& law, int first) {
  const std::string wrong = Validate(law);
  CHECK(wrong.empty()) << wrong;
  const auto make = [law, first](const Scene& scene, Precision precision, std::span<const OptionValue>) {
    return MakeModelSimulator(scene, precision, NeuralEvent(law, first, scene.units));
  };
  return Contact(std::make_shared<const ContactEntry>(
      ContactEntry{NeuralEvent::kTraits, {}, &internal::ReasonModelNotApplicable<NeuralEvent>, make}));
}

Contact LearnedContact(const EventFunctions& events, int first) {
  const auto make = [events, first](const Scene& scene, Precision precision, std::span<const OptionValue>) {
    const std::string wrong = Validate(events, scene);
    CHECK(wrong.empty()) << wrong;
    return MakeModelSimulator(scene, precision, LearnedEvents(events, first, scene.units));
  };
  return Contact(std::make_shared<const ContactEntry>(
      ContactEntry{LearnedEvents::kTraits, {}, &internal::ReasonModelNotApplicable<LearnedEvents>, make}));
}

}  // namespace saltus
