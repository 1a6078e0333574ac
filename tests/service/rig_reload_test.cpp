#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "service/rig_reload.h"

namespace penumbra::service {
namespace {

using testing::ElementsAre, testing::IsEmpty;

std::vector<std::string> changed(std::string_view before, std::string_view now) {
  const auto keys = changed_keys(before, now, "rig.toml");
  EXPECT_TRUE(keys) << keys.error().detail;
  return keys.value_or(std::vector<std::string>());
}

TEST(ChangedKeys, AreNamedByTheirPlace) {
  constexpr const char* kBefore =
      "version = 1\n[light]\nbands = 3\nmax_lights = 2\n"
      "[[camera]]\nname = \"a\"\nexposures_s = [0.1, 0.2]\n[[camera]]\nname = \"b\"\n";
  EXPECT_THAT(changed(kBefore, kBefore), IsEmpty());
  EXPECT_THAT(changed(kBefore,
                      "version = 1\n[light]\nbands = 5\nmax_lights = 2\n"
                      "[[camera]]\nname = \"a\"\nexposures_s = [0.1, 0.3]\n[[camera]]\n"
                      "name = \"b\"\n"),
              ElementsAre("camera[0].exposures_s", "light.bands"));
  EXPECT_THAT(changed(kBefore, "version = 1\n[light]\nbands = 3\n[pose]\nsource = \"board\"\n"),
              ElementsAre("camera[0].exposures_s", "camera[0].name", "camera[1].name",
                          "light.max_lights", "pose.source"));
}

TEST(ChangedKeys, OfWhatIsWrittenOtherwiseAreNone) {
  EXPECT_THAT(changed("[light]\nbands = 3 # few\n", "light = { bands = 3 }\n"), IsEmpty());
  EXPECT_THAT(changed("[light]\nstale_after_s = 1\n", "[light]\nstale_after_s = 1.5\n"),
              ElementsAre("light.stale_after_s"));
}

TEST(ChangedKeys, OfABrokenTextAreNone) {
  const auto keys = changed_keys("version = 1", "[light\n", "rig.toml");
  ASSERT_FALSE(keys);
  EXPECT_NE(keys.error().where.find("rig.toml:1"), std::string::npos) << keys.error().where;
}

}  // namespace
}  // namespace penumbra::service
