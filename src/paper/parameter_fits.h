// Fits of one recording under every contact model: wrong gradients lead to wrong parameters. There are two fits: one to
// a recording of exact motion, in which both a model's motion and its gradient matter, and one to a recording of the
// model's motion, in which only its gradient matters.
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
  // Contact models that cannot simulate the scene are left out, and plastic ones, which cannot explain a bounce.
  explicit ParameterFits(const std::vector<std::string>& contacts);

  // Returns false if interrupted.
  bool Run(int threads, ProgressMode progress);

  CaptionedTable ToTable() const;
  PaperFigure ToFigure() const;
  // Returns the findings, in a sentence or two each.
  std::vector<std::string> Findings() const;

 private:
  enum Of { kExactMotion, kOwnMotion };
  struct Fit {
    std::string contact;
    Of of = kExactMotion;
    std::optional<IdentifyReport> report;  // none: the model has no motion of the true parameters

    // Returns the largest |value - true value| / true value of all parameters; std::nullopt if one is not determined.
    std::optional<double> LargestBias(const Scene& truth) const;
    // Whether all are determined, and as close to the truth as the stated standard errors promise.
    bool IsHonest(const Scene& truth) const;
  };
  void Compute(Fit* fit) const;
  const Fit* Find(const std::string& contact, Of of) const;

  Scene truth_;
  std::vector<std::string> contacts_;
  std::vector<Fit> fits_;
};

// Learns the law of a ball dropped from four heights, whose restitution falls with speed. std::nullopt if interrupted.
std::optional<PaperFigure> LearnALaw();

}  // namespace saltus
