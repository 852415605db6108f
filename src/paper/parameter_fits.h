// Wrong gradients, wrong parameters: the same fit of a recording under every contact model. Twice: to a recording of
// exact motion, where a model's motion and its gradient both tell, and to one of the model's own motion, where only
// its gradient does.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "paper/paper_figures.h"
#include "paper/solver_comparison.h"
#include "saltus/identify/identify.h"

namespace saltus {

class ParameterFits {
 public:
  // Contact models that cannot take the scene are left out, and plastic ones, which cannot explain a bounce.
  explicit ParameterFits(const std::vector<std::string>& contacts);

  // False if interrupted.
  bool Run(int threads, ProgressMode progress);

  CaptionedTable ToTable() const;
  PaperFigure ToFigure() const;
  // What the numbers say, a sentence or two each.
  std::vector<std::string> Findings() const;

 private:
  enum Of { kExactMotion, kOwnMotion };
  struct Fit {
    std::string contact;
    Of of = kExactMotion;
    std::optional<IdentifyReport> report;  // none: the model has no motion of the true parameters

    // Of all parameters, the largest |value - true value| / true value; nothing if one is not determined.
    std::optional<double> LargestBias(const Scene& truth) const;
    // Whether all are determined, and as near to the truth as the stated standard errors promise.
    bool IsHonest(const Scene& truth) const;
  };
  void Compute(Fit* fit) const;
  const Fit* Find(const std::string& contact, Of of) const;

  Scene truth_;
  std::vector<std::string> contacts_;
  std::vector<Fit> fits_;
};

// A ball is dropped from four heights on a floor whose restitution falls with the speed. Nothing if interrupted.
std::optional<PaperFigure> LearnALaw();

}  // namespace saltus
