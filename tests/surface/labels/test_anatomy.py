"""Names of labels: what one states about another in which it lies, in the spellings of several data sets."""

from __future__ import annotations

import pytest

from palpate.surface.labels.anatomy import is_stiff_lesion, relation, tissue_of

# organ | label that lies in it | relation
CASES = """
    liver | lung_right | OTHER
    liver | liver_tumor | LESION
    liver | Tumor | LESION
    liver | tumour | LESION
    liver | Neoplasm, Primary | LESION
    liver | mets | LESION
    liver | liver_vessels | VESSEL
    liver | hepatic vessels | VESSEL
    liver | portal_vein_and_splenic_vein | VESSEL
    spleen | portal_vein_and_splenic_vein | VESSEL
    pancreas | portal_vein_and_splenic_vein | OTHER
    liver | inferior_vena_cava | OTHER
    liver | postcava | OTHER
    liver | IVC | OTHER
    liver | gallbladder | OTHER
    liver | Gall Bladder | OTHER
    bladder | gall_bladder | OTHER
    urinary_bladder | bladder_tumour | LESION
    liver | liver_segment_1 | PART
    Liver | Segment_1 | UNKNOWN
    Leber | Lebertumor | LESION
    Leber | Lunge rechts | OTHER
    kidney_left | kidney_cyst_left | LESION
    kidney_left | kidney_cyst_right | OTHER
    kidney_left | kidney_cyst | LESION
    left kidney | KidneyCyst_L | LESION
    left kidney | Right Kidney | OTHER
    kidney_left | adrenal_gland_left | OTHER
    kidney | renal_pelvis | PART
    kidney | cyst | LESION
    lung_upper_lobe_left | lung_lower_lobe_left | OTHER
    lung_left | lung_upper_lobe_left | PART
    lung_upper_lobe_left | lung_nodule | LESION
    liver | lung_nodule | OTHER
    liver | kidney_cyst | OTHER
    liver | renal_vein | OTHER
    liver | vein | VESSEL
    liver | hepatic_artery | VESSEL
    liver | bile duct | VESSEL
    pancreas | pancreatic_duct | VESSEL
    gallbladder | cystic_duct | VESSEL
    heart | heart_atrium_left | PART
    heart | atrium | PART
    heart_atrium_left | heart_ventricle_left | OTHER
    heart | aorta | OTHER
    vertebrae_L5 | vertebrae_L4 | OTHER
    sacrum | vertebrae_L5 | OTHER
    femur_left | hip_left | OTHER
    rib_left_1 | rib_left_10 | OTHER
    label 1 | label 2 | UNKNOWN
    label 1 | lung_right | OTHER
    label 1 | Mass | LESION
    label 1 | liver_tumor | LESION
    label 1 | liver segment 1 | OTHER
    tissue | right lung | OTHER
    tissue | ribs | OTHER
    brain | edema | UNKNOWN
    brain | cerebellum | PART
    brain | lymphoma | LESION
    liver | Lymph nodes | OTHER
    liver | hemangioma | LESION
    liver | HCC | LESION
    liver | fat | UNKNOWN
    Liver | Right lobe of liver | PART
    prostate | peripheral zone | UNKNOWN
    prostate | prostate/uterus | PART
    colon | colon_cancer | LESION
    liver | esophagus | OTHER
    liver | Oesophagus | OTHER
    liver | arota | OTHER
    lungs | lung_right | PART
    lung_right | lungs | OTHER
    liver | spleens | OTHER
    liver | liver lésion | LESION
    liver | duodenum | OTHER
    spleen | accessory spleen | PART
    liver | muscles | OTHER
    liver | stomachContent | OTHER
    Liver | LIVER CYST | LESION
    liver | massive thing | UNKNOWN
    liver | heart | OTHER
    vertebrae_body | intervertebral_discs | UNKNOWN
    liver | costal_cartilages | OTHER
    liver | small_bowel | OTHER
    Segment_1 | Segment_10 | UNKNOWN
    liver | Vessel | VESSEL
    liver | GTV1 | LESION
    liver | GTVp | LESION
    liver | HCC_2 | LESION
    brain | met3 | LESION
    liver | livercancer | LESION
    liver | metal | UNKNOWN
    spine | L1 | UNKNOWN
"""


@pytest.mark.parametrize("line", CASES.strip().splitlines())
def test_the_name_of_a_label_states_what_it_is_of_an_organ(line):
    organ, inner, expected = (word.strip() for word in line.split("|"))
    assert relation(inner, organ).name == expected


@pytest.mark.parametrize(("name", "stiff"), [
    ("liver_tumour", True), ("Mass", True), ("Metastases", True), ("HCC", True), ("kidney_cyst_left", False),
    ("haemangioma", False), ("cystic tumour", False), ("liver_vessels", False), ("massive thing", False),
    ("mass1", True), ("HCC2", True),
])  # fmt: skip
def test_solid_lesions_are_stiff(name, stiff):
    assert is_stiff_lesion(name) is stiff


KINDS = {
    "bone": "vertebrae_L1 rib_left_7 hip_left sacrum femur_right costal_cartilages sternum skull clavicula_left Ribs",
    "vessel": "aorta inferior_vena_cava portal_vein_and_splenic_vein iliac_artery_left iliac_vena_right lung_vessels "
    "brachiocephalic_trunk common_carotid_artery_left pulmonary_vein IVC postcava",
    "organ": "liver spleen kidney_left adrenal_gland_right lung_upper_lobe_left small_bowel colon urinary_bladder "
    "prostate gallbladder stomach heart_atrium_left brain trachea Leber liver_tumor thyroid_gland",
    "muscle": "gluteus_maximus_left autochthon_right iliopsoas_left quadriceps_femoris_left thigh_muscle",
    "other": "spinal_cord label_7 background skin",
}


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, names in KINDS.items() for name in names.split()])
def test_the_name_of_a_label_states_its_kind_of_tissue(kind, name):
    assert tissue_of(name).value == kind
