#include "saltus/dynamics/learned_contact.h"

#include <glog/logging.h>

#include "contact/neural_event.h"
#include "saltus/dynamics/own_contact.h"

namespace saltus {

Contact LearnedContact(const ImpactLaw& law, int first) {
  const std::string wrong = WhatIsWrongWith(law);
  CHECK(wrong.empty()) << wrong;
  const auto make = [law, first](const Scene& scene, Precision precision, std::span<const OptionValue>) {
    return std::make_unique<ModelSimulator<NeuralEvent, double>>(
        scene, precision, NeuralEvent(law, first, scene.units));
  };
  return Contact(std::make_shared<const ContactEntry>(
      ContactEntry{NeuralEvent::kTraits, {}, &internal::WhyModelNotApplicable<NeuralEvent>, make}));
}

}  // namespace saltus
