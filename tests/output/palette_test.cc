#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <set>
#include <string>
#include <tuple>

#include "output/figure.h"

namespace saltus {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

Vector3d LinearRgb(std::string_view colour) {
  EXPECT_EQ(colour.size(), 7u) << colour;
  Vector3d rgb;
  for (int i = 0; i < 3; ++i) {
    const double c = std::stoi(std::string(colour.substr(static_cast<size_t>(1 + 2 * i), 2)), nullptr, 16) / 255.0;
    rgb[i] = c <= 0.04045 ? c / 12.92 : std::pow((c + 0.055) / 1.055, 2.4);
  }
  return rgb;
}

// Ottosson's OKLab, in which equal distances look equally large.
Vector3d OkLab(const Vector3d& linear) {
  const Matrix3d to_lms{{0.4122214708, 0.5363325363, 0.0514459929},
                        {0.2119034982, 0.6806995451, 0.1073969566},
                        {0.0883024619, 0.2817188376, 0.6299787005}};
  const Matrix3d to_lab{{0.2104542553, 0.7936177850, -0.0040720468},
                        {1.9779984951, -2.4285922050, 0.4505937099},
                        {0.0259040371, 0.7827717662, -0.8086757660}};
  const Vector3d lms = to_lms * linear.cwiseMax(0.0).cwiseMin(1.0);
  return to_lab * Vector3d(std::cbrt(lms[0]), std::cbrt(lms[1]), std::cbrt(lms[2]));
}

// Machado, Oliveira and Fernandes 2009, severity 1; and normal vision.
const Matrix3d kVisions[] = {
    Matrix3d::Identity(),
    Matrix3d{{0.152286, 1.052583, -0.204868}, {0.114503, 0.786281, 0.099216}, {-0.003882, -0.048116, 1.051998}},
    Matrix3d{{0.367322, 0.860646, -0.227968}, {0.280085, 0.672501, 0.047413}, {-0.011820, 0.042940, 0.968881}}};

double SmallestDistance(std::string_view a, std::string_view b) {
  double smallest = 1;
  for (const Matrix3d& vision : kVisions) {
    smallest = std::min(smallest, (OkLab(vision * LinearRgb(a)) - OkLab(vision * LinearRgb(b))).norm());
  }
  return smallest;
}

TEST(PaletteTest, ColoursAreToldApartWithAnyColourVision) {
  const std::vector<ModelStyle>& styles = ModelStyles();
  for (size_t i = 0; i < styles.size(); ++i) {
    for (size_t j = 0; j < i; ++j) {
      // The models of the paper, which share most figures, are the first dozen.
      const double required = i < 12 ? 0.10 : 0.07;
      EXPECT_GT(SmallestDistance(styles[i].colour, styles[j].colour), required)
          << styles[i].model << " and " << styles[j].model;
    }
  }
}

TEST(PaletteTest, ColoursStandOutFromPaper) {
  for (const ModelStyle& style : ModelStyles()) {
    EXPECT_LT(OkLab(LinearRgb(style.colour))[0], 0.8) << style.model;
  }
}

TEST(PaletteTest, EveryModelHasItsOwnStyle) {
  std::set<std::tuple<Dash, Marker, std::string_view>> looks;
  for (const ModelStyle& style : ModelStyles()) {
    EXPECT_TRUE(looks.insert({style.dash, style.marker, style.colour}).second) << style.model;
    EXPECT_EQ(StyleOf(style.model).model, style.model);
    EXPECT_EQ(ColourOf(style.model), style.colour);
  }
  EXPECT_EQ(ColourOf("analytic"), "#000000");
}

TEST(PaletteTest, UnknownNamesGetAFixedStyleThatIsNotTheAnalyticOne) {
  // FNV-1a of "a" is e40c292c (the authors' test vector), 1 + that mod 25 is 21.
  EXPECT_EQ(StyleOf("a").model, ModelStyles()[1 + 0xe40c292cu % 25].model);
  for (char c = 'a'; c <= 'z'; ++c) EXPECT_NE(StyleOf(std::string(3, c)).model, "analytic");
}

TEST(PaletteTest, RampGrowsLighter) {
  EXPECT_EQ(RampColour(0), "#2B2276");
  EXPECT_EQ(RampColour(1), "#F2A632");
  EXPECT_EQ(RampColour(-1), RampColour(0));
  EXPECT_EQ(RampColour(2), RampColour(1));
  double before = 0;
  for (int i = 0; i <= 20; ++i) {
    const double lightness = OkLab(LinearRgb(RampColour(i / 20.0)))[0];
    EXPECT_GT(lightness, before);
    before = lightness;
  }
}

}  // namespace
}  // namespace saltus
