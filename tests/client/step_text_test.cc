#include "client/step_text.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "client/step_model.h"
#include "client/step_tessellation.h"
#include "client/step_unit.h"

namespace horopter {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

// A file with these entities.
std::string File(const std::string& data) {
  return "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\nENDSEC;\nDATA;\n" + data +
         "\nENDSEC;\nEND-ISO-10303-21;\n";
}

// The views of a parse are into its text.
struct Parsed {
  std::string text;
  StepText step;
  explicit Parsed(const std::string& data) : text(File(data)) {
    auto parsed = StepText::Parse(text);
    EXPECT_TRUE(parsed.ok()) << parsed.status();
    if (parsed.ok()) step = *std::move(parsed);
  }
};

TEST(StepText, StringsAreDecodedWhateverTheirCoding) {
  EXPECT_EQ(StepString("'plain'"), "plain");
  EXPECT_EQ(StepString(" 'it''s' "), "it's");
  EXPECT_EQ(StepString("'Gr\\X2\\00F600DF\\X0\\e 1'"), "Größe 1");
  EXPECT_EQ(StepString("'\\X4\\0001F529\\X0\\'"), "🔩");
  EXPECT_EQ(StepString("'\\X2\\D83DDD29\\X0\\'"), "🔩");
  EXPECT_EQ(StepString("'Gr\\X\\F6\\X\\DFe'"), "Größe");
  EXPECT_EQ(StepString("'Gr\\S\\vsse'"), "Grösse");
  EXPECT_EQ(StepString("'\\PA\\Gr\\S\\vsse'"), "Grösse");
  EXPECT_EQ(StepString("'Größe'"), "Größe");  // UTF-8 as it is
  EXPECT_EQ(StepString("'Gr\xF6\xDF"
                       "e'"),
            "Größe");  // Latin-1
  EXPECT_EQ(StepString("'Gr\xC3\x83\xC2\xB6\xC3\x83\xC2\x9F"
                       "e'"),
            "Größe");  // UTF-8 twice
  EXPECT_EQ(StepString("'螺栓'"), "螺栓");
  EXPECT_EQ(StepString("'C:\\\\parts'"), "C:\\parts");
  EXPECT_EQ(StepString("'\\X2\\zz'"), "zz");  // broken, but no end of the program
  EXPECT_EQ(StepString("'\\X\\'"), "\\X\\");
  EXPECT_EQ(StepString("$"), "");
  EXPECT_EQ(StepString("''"), "");
  EXPECT_EQ(StepString("'"), "");
  EXPECT_TRUE(IsCleanUtf8("Größe 螺栓"));
  EXPECT_FALSE(IsCleanUtf8("a\nb"));
  EXPECT_FALSE(IsCleanUtf8("\xC2\x9F"));
  EXPECT_FALSE(IsCleanUtf8("\xF6"));
}

TEST(StepText, EntitiesAreFoundWhateverTheirLayout) {
  const Parsed p(
      "#1=A('#7; not one',(#2,#3),$);#2 = B ( 'x' ) ; /* #9=Z(#1); */\n"
      "#3\n=\n( C(1.5) D(#2,\n#4) E() );\n#5=F(*,.T.,((1,2),(3)));#2=B('again');");
  EXPECT_THAT(p.step.ids(), ElementsAre(1, 2, 3, 5));
  EXPECT_THAT(p.step.ReferencesOf(1), ElementsAre(2, 3));
  EXPECT_THAT(p.step.ReferencesOf(3), ElementsAre(2, 4));
  EXPECT_THAT(p.step.UsersOf(2), ElementsAre(1, 3));
  EXPECT_FALSE(p.step.Holds(4));
  EXPECT_FALSE(p.step.Holds(9));
  EXPECT_EQ(p.step.TypeOf(3), "C");
  EXPECT_TRUE(p.step.Is(3, "E"));
  EXPECT_FALSE(p.step.Is(3, "B"));
  EXPECT_THAT(p.step.OfType("D"), ElementsAre(3));
  EXPECT_THAT(p.step.Parameters(3, "C"), ElementsAre("1.5"));
  EXPECT_THAT(p.step.Parameters(3, "E"), IsEmpty());
  EXPECT_THAT(p.step.Parameters(1), ElementsAre("'#7; not one'", "(#2,#3)", "$"));
  EXPECT_THAT(StepList(p.step.Parameters(5)[2]), ElementsAre("(1,2)", "(3)"));
  EXPECT_THAT(p.step.Parameters(99), IsEmpty());
}

TEST(StepText, WhatIsNoFileIsRefused) {
  EXPECT_FALSE(StepText::Parse("").ok());
  EXPECT_FALSE(StepText::Parse("Dear Sir").ok());
  const std::string whole = File("#1=A('x');");
  EXPECT_FALSE(StepText::Parse(whole.substr(0, whole.size() / 2)).ok());
  for (const char* odd : {"#1=", "#1=A(", "#1=A('", "#=A();", "#99999999999=A();", "#1=A(/*"}) {
    const Parsed p(odd);
    EXPECT_THAT(p.step.OfType("B"), IsEmpty());
  }
}

// Units named this and that, all of 25.4 mm.
TEST(StepUnit, TheFactorCountsNotTheWord) {
  const std::string shape =
      "#1=SHAPE_REPRESENTATION('',(),#2);#2=(GEOMETRIC_REPRESENTATION_CONTEXT(3) "
      "GLOBAL_UNIT_ASSIGNED_CONTEXT((#3,#9)) REPRESENTATION_CONTEXT('',''));"
      "#9=(NAMED_UNIT(*) PLANE_ANGLE_UNIT() SI_UNIT($,.RADIAN.));";
  const std::string mm = "#5=(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.));";
  const auto metres = [&](const std::string& unit) {
    const Parsed p(shape + unit);
    return LengthUnitOf(p.step).metres;
  };
  EXPECT_DOUBLE_EQ(metres("#3=(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT($,.METRE.));"), 1.0);
  EXPECT_DOUBLE_EQ(metres("#3=(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.CENTI.,.METRE.));"), 1e-2);
  EXPECT_DOUBLE_EQ(metres("#3=(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MICRO.,.METRE.));"), 1e-6);
  for (const char* word : {"INCH", "MY", "CUSTOM_INCH", "MM", ""}) {
    const std::string unit = std::string("#3=(CONVERSION_BASED_UNIT('") + word +
                             "',#4) LENGTH_UNIT() NAMED_UNIT(#8));#4=LENGTH_MEASURE_WITH_UNIT("
                             "LENGTH_MEASURE(25.4),#5);";
    EXPECT_NEAR(metres(unit + mm), 0.0254, 1e-12) << word;
  }
  // Of another converted unit; the measure without its type, and as a complex entity.
  const std::string inch =
      "#6=(CONVERSION_BASED_UNIT('INCH',#7) LENGTH_UNIT() NAMED_UNIT(#8));"
      "#7=(LENGTH_MEASURE_WITH_UNIT() MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#5));";
  EXPECT_NEAR(metres("#3=(CONVERSION_BASED_UNIT('FOOT',#4) LENGTH_UNIT() NAMED_UNIT(#8));"
                     "#4=LENGTH_MEASURE_WITH_UNIT(12.,#6);" +
                     inch + mm),
              0.3048,
              1e-12);
  // None, one that is not there, and one that needs itself.
  EXPECT_EQ(metres(""), 0.0);
  EXPECT_EQ(metres("#3=(CONVERSION_BASED_UNIT('INCH',#4) LENGTH_UNIT() NAMED_UNIT(#8));"), 0.0);
  EXPECT_EQ(metres("#3=(CONVERSION_BASED_UNIT('INCH',#4) LENGTH_UNIT() NAMED_UNIT(#8));"
                   "#4=LENGTH_MEASURE_WITH_UNIT(2.,#3);"),
            0.0);
}

// An assembly of two products, one placed twice; `body` is what the bolt's shape holds.
std::string Assembly(const std::string& body =
                         "#40=MANIFOLD_SOLID_BREP('Boss-Extrude1',#41);#41=CLOSED_SHELL('',());") {
  return "#1=PRODUCT('top','Whole','',());#2=PRODUCT_DEFINITION_FORMATION('','',#1);"
         "#3=PRODUCT_DEFINITION('','',#2,$);#4=PRODUCT_DEFINITION_SHAPE('','',#3);"
         "#5=SHAPE_DEFINITION_REPRESENTATION(#4,#6);#6=SHAPE_REPRESENTATION('',(),$);"
         "#11=PRODUCT('b','Bolt \\X2\\00D8\\X0\\8','',());"
         "#12=PRODUCT_DEFINITION_FORMATION_WITH_SPECIFIED_SOURCE('','',#11,.MADE.);"
         "#13=PRODUCT_DEFINITION('','',#12,$);#14=PRODUCT_DEFINITION_SHAPE('','',#13);"
         "#15=SHAPE_DEFINITION_REPRESENTATION(#14,#16);#16=SHAPE_REPRESENTATION('',(),$);"
         "#17=SHAPE_REPRESENTATION_RELATIONSHIP('','',#16,#18);"
         "#18=ADVANCED_BREP_SHAPE_REPRESENTATION('',(#40),$);"
         "#21=PRODUCT('plate','','',());#22=PRODUCT_DEFINITION_FORMATION('','',#21);"
         "#23=PRODUCT_DEFINITION('','',#22,$);#24=PRODUCT_DEFINITION_SHAPE('','',#23);"
         "#25=SHAPE_DEFINITION_REPRESENTATION(#24,#26);"
         "#26=ADVANCED_BREP_SHAPE_REPRESENTATION('',(#27),$);"
         "#27=MANIFOLD_SOLID_BREP('NONE',#28);#28=CLOSED_SHELL('',());"
         "#31=NEXT_ASSEMBLY_USAGE_OCCURRENCE('1','','',#3,#13,$);"
         "#32=NEXT_ASSEMBLY_USAGE_OCCURRENCE('2','','',#3,#13,$);"
         "#33=NEXT_ASSEMBLY_USAGE_OCCURRENCE('3','','',#3,#23,$);" +
         body;
}

TEST(StepModel, ABodyHasTheNameOfItsProduct) {
  const Parsed p(Assembly());
  EXPECT_THAT(BodiesOf(p.step), ElementsAre(27, 40));
  EXPECT_EQ(ProductNameOf(p.step, 40), "Bolt Ø8");  // through the relationship
  EXPECT_EQ(ProductNameOf(p.step, 27), "plate");    // the id where the name is empty
  EXPECT_EQ(RootProductName(p.step), "Whole");
  EXPECT_EQ(MissingEntities(p.step), "");
  EXPECT_THAT(ExternalFiles(p.step), IsEmpty());
  EXPECT_THAT(EmptyShapes(p.step), IsEmpty());
}

TEST(StepModel, LongAndOddNamesStayNames) {
  std::string name(99, 'x');
  const auto named = [](const std::string& product) {
    const Parsed p("#1=PRODUCT('id'," + product +
                   ",'',());#2=PRODUCT_DEFINITION_FORMATION('','',#1);"
                   "#3=PRODUCT_DEFINITION('','',#2,$);#4=PRODUCT_DEFINITION_SHAPE('','',#3);");
    return RootProductName(p.step);
  };
  EXPECT_EQ(named("'" + name + "ö'"), name);  // no half characters
  EXPECT_EQ(named("'" + std::string(300, 'y') + "'"), std::string(100, 'y'));
  EXPECT_EQ(named("'a\tb'"), "a b");
  EXPECT_EQ(named("'  '"), "id");
  EXPECT_EQ(named("'Open CASCADE STEP translator 7.6 2'"), "id");
}

TEST(StepModel, WhatAPartIsMissingIsNamed) {
  const Parsed gone(Assembly(""));
  EXPECT_THAT(MissingEntities(gone.step),
              HasSubstr("#18 (ADVANCED_BREP_SHAPE_REPRESENTATION) names #40"));
  EXPECT_THAT(MissingEntities(gone.step), HasSubstr("2 of 3 parts"));
  EXPECT_THAT(MissingEntities(gone.step), HasSubstr("Bolt Ø8"));
  const Parsed deep(Assembly("#40=MANIFOLD_SOLID_BREP('',#41);#41=CLOSED_SHELL('',(#42));"));
  EXPECT_THAT(MissingEntities(deep.step), HasSubstr("#41 (CLOSED_SHELL) names #42"));
  // A note that names what is not there is no part.
  const Parsed note(Assembly() + "#90=ANNOTATION_OCCURRENCE('',(#91),#92);");
  EXPECT_EQ(MissingEntities(note.step), "");
  const Parsed unknown(Assembly("#40=SOLID_OF_TOMORROW('',#41);#41=CLOSED_SHELL('',());"));
  EXPECT_THAT(EmptyShapes(unknown.step), ElementsAre(18));
}

TEST(StepModel, BodiesAreHiddenByStyleLayerOrRepresentation) {
  const auto hidden = [](const std::string& more) {
    const Parsed p(Assembly() + more);
    return HiddenBodiesOf(p.step).bodies;
  };
  EXPECT_THAT(hidden("#50=STYLED_ITEM('',(),#27);"), IsEmpty());
  EXPECT_THAT(hidden("#50=STYLED_ITEM('',(),#27);#51=INVISIBILITY((#50));"), ElementsAre(27));
  EXPECT_THAT(
      hidden("#50=PRESENTATION_LAYER_ASSIGNMENT('1','',(#27,#40));#51=INVISIBILITY((#50));"),
      ElementsAre(27, 40));
  EXPECT_THAT(hidden("#49=STYLED_ITEM('',(),#40);#50=PRESENTATION_LAYER_ASSIGNMENT('1','',(#49));"
                     "#51=INVISIBILITY((#50));"),
              ElementsAre(40));
  EXPECT_THAT(hidden("#50=OVER_RIDING_STYLED_ITEM('',(),#27,#49);#51=INVISIBILITY((#50));"),
              ElementsAre(27));
  EXPECT_THAT(hidden("#50=STYLED_ITEM('',(),#26);#51=INVISIBILITY((#50));"), ElementsAre(27));
  EXPECT_THAT(hidden("#50=INVISIBILITY((#50));"), IsEmpty());
  const Parsed one(Assembly() +
                   "#50=CONTEXT_DEPENDENT_OVER_RIDING_STYLED_ITEM('',(),#40,#49,(#31));"
                   "#51=INVISIBILITY((#50));");
  EXPECT_THAT(HiddenBodiesOf(one.step).bodies, IsEmpty());
  EXPECT_EQ(HiddenBodiesOf(one.step).single_places, 1);
}

TEST(StepModel, FilesOfPartsWithoutGeometryAreNamed) {
  const std::string files =
      "#60=DOCUMENT_FILE('bolt.stp','',$,$,'',$);#61=DOCUMENT_FILE('drawing.pdf','',$,$,'',$);"
      "#62=EXTERNAL_SOURCE(IDENTIFIER('M\\X2\\00FC\\X0\\ller.stp'));";
  const Parsed with(Assembly() + files);  // geometry is here: these are something else
  EXPECT_THAT(ExternalFiles(with.step), IsEmpty());
  std::string text = Assembly("");
  text.replace(text.find("(#40)"), 5, "()");
  const Parsed without(text + files);
  EXPECT_THAT(ExternalFiles(without.step), ElementsAre("Müller.stp", "bolt.stp"));
}

TEST(StepTessellation, FacesStripsAndFansAreTriangles) {
  const std::string points =
      "#1=COORDINATES_LIST('',4,((0.,0.,0.),(1.,0.,0.),(0.,1.,0.),(1.,1.,0.)));";
  const auto triangles = [&](const std::string& faces) {
    const Parsed p(points + faces);
    EXPECT_TRUE(HoldsTessellation(p.step));
    const auto mesh = TessellationOf(p.step);
    return mesh.ok() ? mesh->triangles : std::vector<Eigen::Vector3i>();
  };
  EXPECT_THAT(triangles("#2=TRIANGULATED_FACE('',#1,4,(),$,(),((1,2,3),(2,4,3)));"), SizeIs(2));
  EXPECT_THAT(triangles("#2=TRIANGULATED_FACE('',#1,3,(),$,(2,4,3),((1,2,3)));"),
              ElementsAre(Eigen::Vector3i(1, 3, 2)));
  EXPECT_THAT(triangles("#2=TRIANGULATED_SURFACE_SET('',#1,4,(),(),((1,2,3)));"), SizeIs(1));
  EXPECT_THAT(triangles("#2=COMPLEX_TRIANGULATED_FACE('',#1,4,(),$,(),((1,2,3,4)),((1,2,4,3)));"),
              ElementsAre(Eigen::Vector3i(0, 1, 2),
                          Eigen::Vector3i(1, 3, 2),
                          Eigen::Vector3i(0, 1, 3),
                          Eigen::Vector3i(0, 3, 2)));
  EXPECT_THAT(triangles("#2=COMPLEX_TRIANGULATED_SURFACE_SET('',#1,4,(),(),((1,2,3,4)),());"),
              SizeIs(2));
  EXPECT_THAT(triangles("#2=TRIANGULATED_FACE('',#1,4,(),$,(),((1,2,5)));"), IsEmpty());
  EXPECT_THAT(triangles("#2=TRIANGULATED_FACE('',#9,4,(),$,(),((1,2,3)));"), IsEmpty());
  EXPECT_THAT(triangles("#2=TRIANGULATED_FACE('',#1);"), IsEmpty());
}

}  // namespace
}  // namespace horopter
