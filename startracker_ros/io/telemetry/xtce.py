# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The space packet in XTCE 1.2 (OMG), for ground systems that read packets by description."""

from xml.etree import ElementTree as XML

from startracker_ros.io.telemetry.report import TrackerCode
from startracker_ros.io.telemetry.space_packet import Field, FIELDS, PRIMARY_HEADER

NAMESPACE = 'http://www.omg.org/spec/XTCE/20180204'


def xtce_text(apid: int) -> str:
    """Return the description of the packets of an apid."""
    XML.register_namespace('xtce', NAMESPACE)
    root = XML.Element(_tag('SpaceSystem'), name='startracker_ros')
    telemetry = XML.SubElement(root, _tag('TelemetryMetaData'))
    types = XML.SubElement(telemetry, _tag('ParameterTypeSet'))
    parameters = XML.SubElement(telemetry, _tag('ParameterSet'))
    for field in (*PRIMARY_HEADER, *FIELDS):
        _add_type(types, field)
        parameter = XML.SubElement(parameters, _tag('Parameter'), name=field.name,
                                   parameterTypeRef=f'{field.name}_TYPE')
        XML.SubElement(parameter, _tag('LongDescription')).text = field.meaning
    containers = XML.SubElement(telemetry, _tag('ContainerSet'))
    _add_container(containers, 'CCSDSPacket', PRIMARY_HEADER).set('abstract', 'true')
    frame = _add_container(containers, 'STAR_TRACKER_FRAME', FIELDS)
    base = XML.SubElement(frame, _tag('BaseContainer'), containerRef='CCSDSPacket')
    criteria = XML.SubElement(base, _tag('RestrictionCriteria'))
    XML.SubElement(criteria, _tag('Comparison'), parameterRef='PKT_APID', value=str(apid),
                   useCalibratedValue='false')
    XML.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{XML.tostring(root, encoding="unicode")}\n'


def _tag(name: str) -> str:
    return f'{{{NAMESPACE}}}{name}'


def _add_type(types: XML.Element, field: Field) -> None:
    """Add the type of a field."""
    if field.name == 'TRACKER_STATE':
        kind = XML.SubElement(types, _tag('EnumeratedParameterType'), name=f'{field.name}_TYPE')
    elif field.kind == 'uint':
        kind = XML.SubElement(types, _tag('IntegerParameterType'), name=f'{field.name}_TYPE',
                              signed='false')
    else:
        kind = XML.SubElement(types, _tag('FloatParameterType'), name=f'{field.name}_TYPE',
                              sizeInBits=str(field.bits))
    units = XML.SubElement(kind, _tag('UnitSet'))
    if field.unit:
        XML.SubElement(units, _tag('Unit')).text = field.unit
    if field.kind == 'uint':
        XML.SubElement(kind, _tag('IntegerDataEncoding'), sizeInBits=str(field.bits),
                       encoding='unsigned')
    else:
        XML.SubElement(kind, _tag('FloatDataEncoding'), sizeInBits=str(field.bits),
                       encoding='IEEE754_1985')
    if field.name == 'TRACKER_STATE':
        labels = XML.SubElement(kind, _tag('EnumerationList'))
        for code in TrackerCode:
            XML.SubElement(labels, _tag('Enumeration'), value=str(int(code)), label=code.name)


def _add_container(containers: XML.Element, name: str, fields: tuple[Field, ...]) -> XML.Element:
    """Add a container of fields, in their order."""
    container = XML.SubElement(containers, _tag('SequenceContainer'), name=name)
    entries = XML.SubElement(container, _tag('EntryList'))
    for field in fields:
        XML.SubElement(entries, _tag('ParameterRefEntry'), parameterRef=field.name)
    return container
